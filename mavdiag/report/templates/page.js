"use strict";
// Charts that zoom and show their values, by uPlot, out of the drawings that the page has anyway; tables that sort.
(() => {
  const UNITS = 4000, HIGH = 1000, LEFT = 52;
  const numbers = (text) => text.split(" ").map(Number);
  const colour = (look) => {
    const probe = document.body.appendChild(document.createElement("i"));
    probe.className = look;
    const found = getComputedStyle(probe).getPropertyValue("--c");
    probe.remove();
    return getComputedStyle(document.documentElement).getPropertyValue(found.match(/--\w+/)?.[0] ?? "--none") || found;
  };
  const own = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);
  const dashes = { simulated: [6, 3], commanded: [2, 3], limit: [10, 5], l2: [4, 2], l3: [7, 3, 2, 3], l4: [2, 3], l6: [7, 3], l7: [7, 3, 2, 3], l8: [2, 3] };

  // The points of a path as [[x...], [y...]], with a null before each part but the first.
  function points(path, [x0, x1], [y0, y1]) {
    const xs = [], ys = [];
    for (const part of path.getAttribute("d").split("M").slice(1)) {
      const steps = part.match(/-?\d+/g).map(Number), tiny = (x1 - x0) * 1e-7;
      let x = steps[0], y = steps[1];
      if (part.includes("V")) { // a bar
        const at = x0 + (x1 - x0) * x / UNITS;
        xs.push(at - tiny, at, at + tiny); ys.push(y0, y1 - (y1 - y0) * steps[2] / HIGH, y0);
        continue;
      }
      if (xs.length && !part.includes("h0")) { xs.push(xs.at(-1) + tiny); ys.push(null); }
      xs.push(x0 + (x1 - x0) * x / UNITS); ys.push(y1 - (y1 - y0) * y / HIGH);
      for (let k = 2; k + 1 < steps.length; k += 2) {
        x += steps[k]; y += steps[k + 1];
        xs.push(x0 + (x1 - x0) * x / UNITS); ys.push(y1 - (y1 - y0) * y / HIGH);
      }
    }
    return [xs, ys];
  }

  function options(plot, paths, key, width, last, zoomed) {
    const x = numbers(plot.dataset.x), y = numbers(plot.dataset.y);
    const axis = { stroke: () => own("--soft"), grid: { stroke: () => own("--grid"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
    const shown = (u, value) => value == null ? "" : Number(value.toPrecision(4)).toString();
    const bands = [...plot.querySelectorAll("rect")].map((box) => ({
      from: box.matches(".healthy") ? null : +box.getAttribute("x") / UNITS, to: (+box.getAttribute("x") + +box.getAttribute("width")) / UNITS,
      top: y[1] - (y[1] - y[0]) * box.getAttribute("y") / HIGH, look: box.getAttribute("class") }));
    const behind = (u) => {
      for (const band of bands) {
        const at = (share) => u.valToPos(x[0] + share * (x[1] - x[0]), "x", true), top = u.valToPos(band.top, "y", true);
        const low = Math.min(u.valToPos(0, "y", true), u.bbox.top + u.bbox.height), { left, width: wide, top: high, height } = u.bbox;
        u.ctx.fillStyle = band.from === null ? own("--healthy") : colour(band.look) + "55";
        if (band.from === null) u.ctx.fillRect(left, Math.max(top, high), wide, Math.max(low - Math.max(top, high), 0));
        else u.ctx.fillRect(Math.max(at(band.from), left), high, Math.min(at(band.to), left + wide) - Math.max(at(band.from), left), height);
      }
    };
    return {
      title: plot.dataset.label,
      width, height: +plot.getAttribute("height") + (last ? 46 : 26), padding: [6, 8, 0, 0],
      scales: { x: { time: false, range: (u, low, high) => low == null ? x : [Math.max(low, x[0]), Math.min(high, x[1])] }, y: { range: () => y } },
      axes: [{ ...axis, label: last ? plot.ownerSVGElement.dataset.name : null, labelSize: 18, labelFont: "12px system-ui, sans-serif", size: 24 }, { ...axis, size: LEFT, space: 24 }],
      legend: { markers: { dash: (u, number) => { const [dash] = u.series[number].dash ?? []; return dash ? dash < 3 ? "dotted" : "dashed" : "solid"; } } },
      cursor: { sync: { key }, drag: { x: true, y: false }, points: { size: 6 } },
      hooks: { drawClear: [behind], setScale: [(u, name) => name === "x" && zoomed(u)] },
      series: [{ label: "time", value: shown }, ...paths.map((path) => {
        const [shape, ...looks] = path.getAttribute("class").split(" "), look = looks[0] ?? shape;
        return { label: path.dataset.label, class: path.dataset.label ? undefined : "unnamed", stroke: () => colour(look), width: look === "limit" ? 2 : 1.3, dash: dashes[look], value: shown, spanGaps: false,
          points: { show: shape === "dots", size: 6, fill: () => colour(look) }, ...(shape === "dots" ? { paths: () => null } : {}) };
      })],
    };
  }

  const groups = new Map(); // of a flight: its charts, and what they show

  function zoomed(group, from) {
    const { min, max } = from.scales.x;
    if (group.busy || min == null) return;
    group.busy = true;
    for (const chart of group.charts) if (chart !== from) chart.setScale("x", { min, max });
    for (const svg of group.following) follow(svg, min, max);
    group.busy = false;
    group.range = [min, max];
  }

  function follow(svg, low, high) {
    for (const plot of svg.querySelectorAll(".plot")) {
      const [x0, x1] = numbers(plot.dataset.x), at = (t) => UNITS * (t - x0) / (x1 - x0);
      plot.setAttribute("viewBox", `${at(low)} 0 ${Math.max(at(high) - at(low), 1e-3)} ${HIGH}`);
    }
    for (const text of svg.querySelectorAll("[data-at]")) {
      text.dataset.told ??= text.textContent;
      const [x0, x1] = numbers(svg.querySelector(".plot").dataset.x), t = low + text.dataset.at * (high - low);
      text.textContent = low === x0 && high === x1 ? text.dataset.told : Number(t.toPrecision(4)).toString();
    }
  }

  function enliven(svg) {
    const figure = svg.parentElement, section = figure.closest("section") ?? document.body;
    const of_whole = svg.querySelector(".plot").dataset.x === section.querySelector(".chart .plot").dataset.x;
    const key = of_whole ? section.id : figure.id;
    if (!groups.has(key)) groups.set(key, { charts: [], following: [...section.querySelectorAll('.chart[data-kind="follow"]')].filter(() => of_whole), range: null });
    const group = groups.get(key), place = figure.insertBefore(document.createElement("div"), svg.nextSibling);
    place.className = "u";
    place.setAttribute("aria-hidden", "true"); // the drawing, its words and the caption say the same
    const plots = [...svg.querySelectorAll(".plot")];
    const made = plots.map((plot, number) => {
      const paths = [...plot.querySelectorAll("path")], x = numbers(plot.dataset.x), y = numbers(plot.dataset.y);
      const data = uPlot.join([...paths.map((path) => points(path, x, y)), [x, [null, null]]]).slice(0, -1);
      return new uPlot(options(plot, paths, key, figure.clientWidth, number === plots.length - 1, (u) => zoomed(group, u)), data, place);
    });
    figure.classList.add("live");
    group.charts.push(...made);
    if (group.range) for (const chart of made) chart.setScale("x", { min: group.range[0], max: group.range[1] });
    new ResizeObserver(() => { for (const chart of made) if (figure.clientWidth && chart.width !== figure.clientWidth) chart.setSize({ width: figure.clientWidth, height: chart.height }); }).observe(figure);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => made.forEach((chart) => chart.redraw(false, true)));
  }

  function sorts(table) {
    const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.append(...head.childNodes);
      head.append(button);
      button.onclick = () => {
        const down = head.getAttribute("aria-sort") === "ascending", value = (row) => row.cells[column].textContent.trim();
        heads.forEach((one) => one.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        body.append(...[...body.rows].sort((a, b) => (down ? -1 : 1) * value(a).localeCompare(value(b), "en", { numeric: true })));
      };
    });
  }

  document.querySelectorAll("table.sorts").forEach(sorts);
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) { seen.unobserve(entry.target); enliven(entry.target); }
  }, { rootMargin: "300px" });
  for (const svg of document.querySelectorAll('.chart[data-kind="zoom"]')) { seen.observe(svg); document.body.classList.add("can-zoom"); }
})();
