// The live page. Everything from outside reaches the page as text (textContent); the airframe's drawing, which the
// detector makes itself, goes through the one trusted type. All changes are made in one animation frame.
"use strict";

const ROWS_MOST = 200; // events in the list
const ENTRIES_MOST = 10000; // events that are kept
const SILENT_MS = 3500; // without anything for so long, the page says so: the detector speaks once a second
const CRITICAL = 2, WARNING = 4;
const NAMES = {
  fault: "Fault", inspect: "Inspect before flight", suspected: "Suspected", quiet: "No fault found", "not judged": "Not judged", off: "Off",
};
const MARKS = {fault: "✕", inspect: "✕", suspected: "!", quiet: "✓", "not judged": "–", off: "○"};

const byId = (id) => document.getElementById(id);
const drawing = window.trustedTypes
  ? window.trustedTypes.createPolicy("drawing", {createHTML: (text) => text})
  : {createHTML: (text) => text};

const page = {
  vehicle: null, about: null, now: null, fleet: null, run: null, last: 0, lost: 0,
  traces: new Map(), entries: [], fresh: [], total: 0, paused: false,
  connection: "connecting", heard: 0, source: null, changed: new Set(), asked: false,
};
window.mavdiag = page; // for a look from the browser's console, and for the tests

function el(tag, properties = {}, ...children) {
  const one = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "data") Object.assign(one.dataset, value);
    else if (name.startsWith("aria-") || name === "role") one.setAttribute(name, value);
    else one[name] = value;
  }
  one.append(...children);
  return one;
}

// --- The stream ----------------------------------------------------------------------------------------------------

function connect() {
  if (page.source) page.source.close();
  const query = new URLSearchParams();
  if (page.vehicle !== null) query.set("vehicle", page.vehicle);
  if (page.run !== null) query.set("after", `${page.run}-${page.last}`);
  const source = new EventSource(`/stream?${query}`);
  page.source = source;
  const on = (name, take) => source.addEventListener(name, (event) => {
    if (source !== page.source) return;
    page.heard = Date.now();
    if (page.connection !== "live") say("live");
    take(event);
  });
  on("hello", (event) => hello(JSON.parse(event.data)));
  on("fleet", (event) => { page.fleet = JSON.parse(event.data); choose(); draw("fleet", "now"); });
  on("about", (event) => { page.about = JSON.parse(event.data); page.traces.clear(); page.now = null; draw("about", "now", "strips", "filter"); });
  on("now", (event) => take(JSON.parse(event.data)));
  on("entry", entry);
  source.onerror = () => {
    if (source !== page.source) return;
    say("lost");
    if (source.readyState === EventSource.CLOSED) setTimeout(() => source === page.source && connect(), 2000);
  };
}

function hello(told) {
  if (page.run !== null && page.run !== told.run) { // another run of the detector: its numbers begin anew
    Object.assign(page, {about: null, now: null, entries: [], fresh: [], total: 0, lost: 0});
    page.traces.clear();
    byId("list").replaceChildren();
    draw("about", "now", "strips", "events");
  }
  page.run = told.run;
  if (told.fresh) page.last = 0;
}

function entry(event) {
  const number = Number(event.lastEventId.split("-").pop());
  if (number <= page.last) return;
  if (page.last) page.lost += number - page.last - 1;
  page.last = number;
  let content;
  try { content = JSON.parse(event.data); } catch { return; }
  const one = {number, content};
  page.entries.push(one);
  page.fresh.push(one);
  page.total += 1;
  if (page.entries.length > ENTRIES_MOST) page.entries.shift();
  draw("events");
}

function take(now) {
  if (now.vehicle !== page.vehicle) return;
  page.now = now;
  for (const strip of now.strips) {
    if (!page.traces.has(strip.axis)) page.traces.set(strip.axis, new Trace());
    page.traces.get(strip.axis).add(strip);
  }
  draw("now", "strips");
}

// The first vehicle is shown, until the user chooses.
function choose() {
  if (page.vehicle === null && page.fleet.vehicles.length) show(page.fleet.vehicles[0].vehicle);
}

function show(vehicle) {
  if (vehicle === page.vehicle) return;
  Object.assign(page, {vehicle, about: null, now: null});
  page.traces.clear();
  draw("fleet", "about", "now", "strips", "filter");
  connect();
}

function say(state) {
  page.connection = state;
  draw("connection");
}

setInterval(() => {
  if (page.connection === "live" && Date.now() - page.heard > SILENT_MS) say("silent");
}, 500);

// --- What is drawn, once a frame -----------------------------------------------------------------------------------

function draw(...parts) {
  for (const part of parts) page.changed.add(part);
  if (page.asked) return;
  page.asked = true;
  if (document.hidden) setTimeout(render, 250); // no frames come in the background
  else requestAnimationFrame(render);
}

const PARTS = {
  connection: renderConnection, fleet: renderFleet, about: renderAbout, now: renderNow, strips: renderStrips,
  events: renderEvents, filter: refilter,
};

function render() {
  page.asked = false;
  const changed = page.changed;
  page.changed = new Set();
  for (const part of Object.keys(PARTS)) if (changed.has(part)) PARTS[part](); // what a part rests on comes before it
}

function text(id, value) {
  const one = typeof id === "string" ? byId(id) : id;
  if (one.textContent !== value) one.textContent = value;
}

function figures(id, rows) {
  const list = byId(id);
  while (list.children.length > 2 * rows.length) list.lastChild.remove();
  rows.forEach(([name, value, state], i) => {
    if (list.children.length <= 2 * i) list.append(el("dt"), el("dd"));
    text(list.children[2 * i], name);
    text(list.children[2 * i + 1], value);
    list.children[2 * i + 1].dataset.state = state || "";
  });
}

function renderConnection() {
  const words = {
    connecting: "connecting", live: "live", lost: "no connection; trying again",
    silent: "nothing comes from the detector",
  };
  byId("connection").dataset.state = page.connection;
  text("connection", words[page.connection]);
  document.body.classList.toggle("stale", page.connection !== "live");
}

function renderFleetRows(vehicles) {
  const body = byId("fleet-rows"), counts = new Map();
  byId("fleet").hidden = vehicles.length < 2;
  while (body.children.length > vehicles.length) body.lastChild.remove();
  vehicles.forEach((one, i) => {
    counts.set(one.level, (counts.get(one.level) || 0) + 1);
    if (body.children.length <= i) {
      const open = el("button", {type: "button"});
      open.addEventListener("click", () => show(Number(open.parentNode.parentNode.dataset.vehicle)));
      body.append(el("tr", {}, el("td", {}, open), ...[1, 2, 3, 4].map(() => el("td"))));
    }
    const row = body.children[i];
    row.dataset.vehicle = String(one.vehicle);
    row.dataset.level = one.level;
    text(row.firstChild.firstChild, `${MARKS[one.level] || ""} ${one.vehicle}`);
    const share = one.flight_s > 0 ? ` (${(100 * one.judged_s / one.flight_s).toFixed(0)} %)` : "";
    [one.sentence, one.state, `${one.judged_s.toFixed(0)} s${share}`, String(one.lost)]
      .forEach((words, column) => text(row.children[column + 1], words));
  });
  text("fleet-counts", [...counts].map(([level, count]) => `${count} ${level}`).join(", "));
}

function renderFleet() {
  const tabs = byId("vehicles"), vehicles = page.fleet ? page.fleet.vehicles : [];
  const known = new Map([...tabs.children].map((tab) => [tab.dataset.vehicle, tab]));
  for (const one of vehicles) {
    const key = String(one.vehicle);
    let tab = known.get(key);
    if (!tab) {
      tab = el("button", {type: "button", role: "tab", "aria-controls": "main", data: {vehicle: key}},
        el("span", {className: "name"}), el("span", {className: "state"}));
      tab.addEventListener("click", () => show(Number(key)));
      tabs.append(tab);
    }
    known.delete(key);
    tab.dataset.level = one.level;
    text(tab.firstChild, `${MARKS[one.level] || ""} Vehicle ${key}`);
    text(tab.lastChild, one.state);
    tab.title = one.sentence;
    const chosen = one.vehicle === page.vehicle;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
  }
  for (const tab of known.values()) tab.remove();
  renderFleetRows(vehicles);
  if (!page.fleet) return;
  const {links, late, cpu_s, uptime_s, refused} = page.fleet;
  figures("machine", [
    ["Running for", span(uptime_s)],
    ["Processor", uptime_s > 0 ? `${(100 * cpu_s / uptime_s).toFixed(1)} % of a core` : "–"],
    ["Late looks", String(late), late ? "warn" : ""],
    ...links.flatMap((one, i) => [[i ? "Link behind" : "Vehicles' link", one.address],
      ["", `${one.connected ? "connected" : "nobody there"}, ${one.sent} sent`
        + (one.dropped ? `, ${one.dropped} dropped` : "") + (one.overflowed ? `, ${one.overflowed} overflowed` : ""),
      one.connected ? "" : "warn"]]),
    ...refused.map(([cause, count]) => [`Refused: ${cause}`, String(count), "warn"]),
  ]);
}

function renderAbout() {
  const about = page.about, place = byId("airframe");
  place.replaceChildren();
  text("layout", about ? [about.airframe && `Airframe ${about.airframe}`, about.layout].filter(Boolean).join(": ") : "");
  if (about && about.drawing) {
    const parsed = new DOMParser().parseFromString(drawing.createHTML(about.drawing), "image/svg+xml");
    if (parsed.documentElement.localName === "svg") place.append(document.importNode(parsed.documentElement, true));
  }
  const slots = about ? about.slots : [];
  byId("no-bars").hidden = slots.length > 0;
  byId("bars").replaceChildren(...slots.map((slot) => el("li", {data: {monitor: slot.name, axis: slot.axis}},
    el("span", {className: "label"}, `${slot.label}${slot.axis ? ` ${slot.axis}` : ""}`),
    el("span", {className: "figure"}),
    el("span", {className: "bar", role: "meter", "aria-valuemin": "0", "aria-valuemax": String(slot.threshold),
      "aria-label": `${slot.label} ${slot.axis}`.trim()}, el("span", {className: "fill"}), el("span", {className: "line"})),
    el("span", {className: "reason"}))));
  const thesis = slots.filter((slot) => slot.margin !== null);
  byId("no-strips").hidden = !slots.length || thesis.length > 0;
  byId("axes").replaceChildren(...thesis.map((slot) => el("div", {className: "axis", data: {axis: slot.axis}},
    el("h3", {}, `${slot.axis[0].toUpperCase()}${slot.axis.slice(1)}: residual `,
      el("span", {className: "fine"}, `rad/s, margin ±${shown(slot.margin)}`), el("span", {className: "value"})),
    el("canvas", {className: "residual", role: "img"}),
    el("h3", {}, "Run length FSD ", el("span", {className: "fine"}, `s, limit FML ${shown(slot.threshold)}`),
      el("span", {className: "value"})),
    el("canvas", {className: "run", role: "img"}))));
}

function renderNow() {
  const now = page.now, level = now ? now.level : "none";
  byId("verdict").dataset.level = level;
  text("mark", MARKS[level] || "");
  text("level-text", now ? NAMES[level] : page.vehicle === null ? "no vehicle yet" : "waiting for figures");
  text("sentence", now ? (now.sentence !== NAMES[level] ? now.sentence : "") : page.vehicle === null ? whatToSend() : "");
  document.title = now ? `${NAMES[level]} – vehicle ${now.vehicle} – mavdiag` : "mavdiag detector";
  renderRotors(now);
  figures("session", now ? [
    ["State", now.state],
    ...([now.state, now.sentence].includes(now.reason) ? [] : [["", now.reason]]),
    ["Flight judged", `${span(now.judged_s)} of ${span(now.flight_s)}`],
    ["Monitor alarms", String(now.events)],
  ] : []);
  const alarm = now && (["fault", "inspect", "suspected"].includes(level));
  byId("alert").hidden = !alarm;
  byId("alert").dataset.level = level;
  byId("acknowledge").hidden = level !== "inspect";
  text("alert", alarm ? `Vehicle ${now.vehicle}: ${now.sentence}` : "");
  if (!now) return figures("link-figures", []), figures("rates", []);
  renderBars(now);
  const {link} = now, total = link.received + link.lost;
  figures("link-figures", [
    ["Last frame", link.silent_s < 1 ? "now" : `${span(link.silent_s)} ago`, link.silent_s > 2 ? "warn" : ""],
    ["Frames", `${link.received} received`],
    ["Lost on the way", total ? `${link.lost} (${(100 * link.lost / total).toFixed(2)} %)` : "–",
      link.lost > 0.02 * total ? "warn" : ""],
    ["Profile", page.about ? page.about.profile : "–"],
    ["Round trip", link.round_trip_s === null ? "–" : `${(1000 * link.round_trip_s).toFixed(0)} ms`],
    ...(link.drift_ppm === null ? [] : [["Clock drift", `${link.drift_ppm.toFixed(1)} ppm`]]),
  ]);
  figures("rates", link.rates.map(([name, hertz]) => [name, hertz ? `${hertz.toFixed(1)} Hz` : "does not come",
    hertz ? "" : "none"]));
}

// What an empty page lacks.
function whatToSend() {
  const link = page.fleet && page.fleet.links[0];
  return `Send the vehicle's MAVLink to ${link ? link.address : "the detector's link"}: its autopilot's HEARTBEAT, a gyro `
    + "(RAW_IMU, SCALED_IMU or HIGHRES_IMU) and ATTITUDE_TARGET.";
}

function renderRotors(now) {
  const svg = byId("airframe").firstElementChild;
  if (!svg) return;
  for (const rotor of svg.querySelectorAll(".rotor")) {
    const number = Number(rotor.dataset.rotor), rise = now ? now.rises[number - 1] : undefined;
    const suspected = now && now.rotor === number;
    rotor.classList.toggle("suspected", Boolean(suspected && now.level === "suspected"));
    rotor.classList.toggle("fault", Boolean(suspected && ["fault", "inspect"].includes(now.level)));
    const whole = Math.round(100 * rise);
    const percent = rise === undefined ? "" : `${whole < 0 ? "−" : whole > 0 ? "+" : ""}${Math.abs(whole)} %`;
    text(rotor.querySelector(".rotor-label"), percent);
    const y = rotor.querySelector(".rotor-disc").cy.baseVal.value;
    rotor.querySelector(".rotor-number").setAttribute("y", String(y + (percent ? 1 : 7)));
  }
}

function renderBars(now) {
  const items = byId("bars").children;
  now.slots.forEach((slot, i) => {
    const item = items[i], about = page.about && page.about.slots[i];
    if (!item || !about) return;
    const [, figure, bar, reason] = item.children, judged = slot.value !== null;
    const ratio = judged ? slot.value / about.threshold : 0;
    item.dataset.state = !judged ? "idle" : ratio > 1 ? "over" : "under";
    const limit = `${shown(about.threshold)} ${about.unit.replace("^2", "²").replace(/^x /, "× ")}`;
    text(figure, judged ? `${shown(slot.value)} of ${limit}` : `threshold ${limit}`);
    text(reason, judged ? (ratio > 1 ? "above its threshold" : "") : `not judged: ${slot.reason}`);
    bar.firstChild.style.width = `${(66.7 * Math.min(1.5, Math.max(0, ratio))).toFixed(1)}%`;
    bar.setAttribute("aria-valuenow", String(judged ? slot.value : 0));
    bar.setAttribute("aria-valuetext", judged ? figure.textContent : reason.textContent);
  });
}

function renderStrips() {
  if (page.paused) return;
  for (const place of byId("axes").children) {
    const axis = place.dataset.axis, trace = page.traces.get(axis) || new Trace();
    const slot = page.about && page.about.slots.find((one) => one.margin !== null && one.axis === axis);
    if (!slot) continue;
    const [residual, run] = place.querySelectorAll("canvas"), values = place.querySelectorAll(".value");
    drawResidual(residual, trace, slot.margin);
    drawRun(run, trace, slot.threshold);
    const last = trace.points[trace.points.length - 1];
    const largest = last ? (-last[1] > last[2] ? last[1] : last[2]) : NaN;
    text(values[0], last ? shown(largest) : "");
    text(values[1], last ? shown(last[3]) : "");
    residual.setAttribute("aria-label", `residual of ${axis} ${shown(largest)} rad/s, margin ${shown(slot.margin)}`);
    run.setAttribute("aria-label", `run length of ${axis} ${last ? shown(last[3]) : "–"} s, limit ${shown(slot.threshold)}`);
  }
}

// --- Events --------------------------------------------------------------------------------------------------------

function renderEvents() {
  const fresh = page.fresh.splice(0).filter(wanted).slice(-ROWS_MOST);
  const added = fresh.reverse().map(row);
  byId("list").prepend(...added);
  setTimeout(() => { for (const one of added) one.dataset.painted = String(Date.now()); }); // after this frame
  const rows = byId("list").children;
  while (rows.length > ROWS_MOST) rows[rows.length - 1].remove();
  count();
}

function refilter() {
  page.fresh.length = 0;
  const found = [];
  for (let i = page.entries.length - 1; i >= 0 && found.length < ROWS_MOST; i -= 1) {
    if (wanted(page.entries[i])) found.push(row(page.entries[i]));
  }
  byId("list").replaceChildren(...found);
  count();
}

function count() {
  const shownRows = byId("list").children.length;
  const lost = page.lost ? `; ${page.lost} older ones were not kept` : "";
  const away = page.entries.filter(folded).length;
  const fold = away ? `; ${away} of monitors that do not decide are folded away` : "";
  text("events-count", `${page.total} received, the latest ${shownRows} shown${lost}${fold}`);
}

// Alarms of monitors that only raise a suspicion are many and decide nothing: they are folded away.
function folded({content}) {
  if (byId("every-monitor").checked || !["opened", "event"].includes(content.kind)) return false;
  const slot = page.about && page.about.slots.find((one) => one.name === content.monitor);
  return Boolean(slot) && !slot.decides;
}

function wanted({content}) {
  if (folded({content})) return false;
  if (!byId("all-vehicles").checked && content.vehicle !== null && content.vehicle !== page.vehicle) return false;
  return !byId("only-alerts").checked || loudness(content) !== "";
}

function loudness(content) {
  if (content.kind === "text") return content.severity <= CRITICAL ? "critical" : content.severity <= WARNING ? "warning" : "";
  if (content.kind === "stage") return {fault: "critical", inspect: "warning", suspected: "warning"}[content.stage] || "";
  return content.kind === "opened" ? "warning" : "";
}

function row({number, content}) {
  const time = new Date(content.utc);
  const clock = Number.isNaN(time.getTime()) ? "–" : time.toLocaleTimeString("en-GB");
  return el("li", {data: {number: String(number), kind: content.kind, utc: content.utc, shown: String(Date.now()), loud: loudness(content)}},
    el("time", {dateTime: content.utc || "", title: content.utc || ""}, clock),
    el("span", {className: "who"}, content.vehicle === null ? "" : `#${content.vehicle}`),
    el("span", {className: "kind"}, content.kind),
    el("span", {className: "words"}, words(content)));
}

function words(content) {
  switch (content.kind) {
    case "text": case "note": return String(content.text);
    case "suppressed": return `held back: ${content.text}`;
    case "state": return `${content.from} → ${content.to}: ${content.reason}`;
    case "stage": return `decision ${content.fault_kind || content.stage}: ${content.reason}`
      + (content.rotor === null ? "" : `, rotor ${content.rotor}`);
    case "opened": case "event": return `${content.kind === "opened" ? "alarm of" : "ended:"} ${content.monitor}`
      + `${content.axis ? ` ${content.axis}` : ""} ${shown(content.statistic)} of ${shown(content.threshold)}`
      + (content.kind === "event" && content.end_s !== null ? `, lasted ${(content.end_s - content.t_s).toFixed(2)} s` : "");
    case "baseline": return `learned a baseline of ${content.airframe}: ${content.layout}`;
    case "start": return `detector ${content.version} started, ${content.connect}`;
    case "stop": return String(content.summary);
    default: return content.kind;
  }
}

function span(seconds) {
  if (seconds < 60) return `${seconds.toFixed(seconds < 10 ? 1 : 0)} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ${Math.floor(seconds % 60)} s`;
  return `${Math.floor(seconds / 3600)} h ${Math.floor(seconds % 3600 / 60)} min`;
}

// --- What the user does --------------------------------------------------------------------------------------------

byId("vehicles").addEventListener("keydown", (event) => {
  const tabs = [...byId("vehicles").children], at = tabs.indexOf(document.activeElement);
  const to = {ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: tabs.length - 1}[event.key];
  if (to === undefined || at < 0) return;
  event.preventDefault();
  const tab = tabs[(to + tabs.length) % tabs.length];
  tab.focus();
  tab.click();
});
byId("pause").addEventListener("click", () => {
  page.paused = !page.paused;
  byId("pause").setAttribute("aria-pressed", String(page.paused));
  text("pause", page.paused ? "Go on" : "Pause");
  draw("strips");
});
byId("acknowledge").addEventListener("click", () => {
  if (page.vehicle !== null) fetch(`/acknowledge?vehicle=${page.vehicle}`, {method: "POST"});
});
byId("only-alerts").addEventListener("change", () => draw("filter"));
byId("all-vehicles").addEventListener("change", () => draw("filter"));
byId("every-monitor").addEventListener("change", () => draw("filter"));
window.addEventListener("resize", () => draw("strips"));
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw("strips"));
connect();
