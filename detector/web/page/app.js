// The live page. Everything from outside reaches the page as text (textContent); the airframe's drawing, which the
// detector makes itself, goes through the one trusted type. All changes are made in one animation frame.
"use strict";

const ROWS_MOST = 200; // events in the list
const ENTRIES_MOST = 10000; // events that are kept
const SILENT_MS = 3500; // without anything for so long, the page says so: the detector speaks once a second
const CRITICAL = 2, WARNING = 4, NOTICE = 5;
const MERGED_S = 60; // alarms of one monitor that follow each other within this time are one event
const NAMES = {
  fault: "Fault", inspect: "Inspect before flight", suspected: "Suspected", quiet: "No fault found", "not judged": "Not judged", off: "Off",
};
const MARKS = {fault: "✕", inspect: "✕", suspected: "!", quiet: "✓", "not judged": "–", off: "○"};

const ALARMS = ["fault", "inspect", "suspected"];
const KINDS = {opened: "alarm", event: "alarm", stage: "decision", text: "said", state: "session", suppressed: "not said"};

const byId = (id) => document.getElementById(id);
const drawing = window.trustedTypes
  ? window.trustedTypes.createPolicy("drawing", {createHTML: (text) => text})
  : {createHTML: (text) => text};

const page = {
  vehicle: null, about: null, now: null, fleet: null, run: null, last: 0, lost: 0,
  traces: new Map(), entries: [], fresh: [], grown: new Set(), alarms: new Map(), total: 0, paused: false,
  playing: null, seek: null, seeking: false,
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
  const source = new EventSource(`stream?${query}`);
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
  on("playing", (event) => { page.playing = JSON.parse(event.data); draw("connection", "replay"); });
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
    for (const known of [page.traces, page.alarms, page.grown]) known.clear();
    draw("about", "now", "strips", "filter");
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
  page.total += 1;
  if (merged(content)) return draw("events");
  const one = {number, content, count: 1, since: content.t_s, highest: ratioOf(content), row: null};
  if (isAlarm(content)) page.alarms.set(keyOf(content), one);
  page.entries.push(one);
  page.fresh.push(one);
  if (page.entries.length > ENTRIES_MOST) page.entries.shift();
  draw("events");
}

// An alarm has two entries, and a monitor at its threshold many alarms: together they are one event.
const isAlarm = ({kind}) => kind === "opened" || kind === "event";
const keyOf = ({vehicle, monitor, axis}) => [vehicle, monitor, axis].join(" ");
const ratioOf = ({statistic, threshold}) => threshold > 0 ? statistic / threshold : 0;

function merged(content) {
  const one = isAlarm(content) && page.alarms.get(keyOf(content));
  const last = one && (one.content.end_s ?? one.content.t_s);
  if (!one || content.t_s > last + MERGED_S || content.t_s < one.since) return false;
  one.count += content.t_s === one.content.t_s ? 0 : 1;
  one.highest = Math.max(one.highest, ratioOf(content));
  one.content = content;
  page.grown.add(one);
  return true;
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
  connection: renderConnection, replay: renderReplay, fleet: renderFleet, about: renderAbout, now: renderNow, strips: renderStrips,
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
    connecting: "connecting", live: page.playing ? "connected" : "live", lost: "no connection; trying again",
    silent: "nothing comes from the detector",
  };
  byId("connection").dataset.state = page.connection;
  text("connection", words[page.connection]);
  document.body.classList.toggle("stale", page.connection !== "live");
}

// A vehicle in a few words: "Fault, motor 3".
function brief({level, rotor}) {
  return `${NAMES[level] || level}${rotor ? `, motor ${rotor}` : ""}`;
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
      tabs.insertBefore(tab, [...tabs.children].find((other) => Number(other.dataset.vehicle) > one.vehicle) ?? null);
    }
    known.delete(key);
    tab.dataset.level = one.level;
    text(tab.firstChild, `${MARKS[one.level] || ""} Vehicle ${key}`);
    text(tab.lastChild, brief(one));
    tab.title = one.sentence;
    const chosen = one.vehicle === page.vehicle;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
  }
  for (const tab of known.values()) tab.remove();
  const counts = Object.keys(NAMES).map((level) => [vehicles.filter((one) => one.level === level).length, NAMES[level]]);
  text("fleet-title", `${vehicles.length} vehicles: `
    + counts.filter(([count]) => count).map(([count, name]) => `${count} ${name.toLowerCase()}`).join(", "));
  byId("fleet").hidden = byId("all").hidden = vehicles.length < 2;
  byId("main").hidden = !vehicles.length;
  byId("empty").hidden = !page.fleet || vehicles.length > 0;
  renderAlert(vehicles);
  if (!page.fleet) return;
  if (!vehicles.length) renderEmpty(page.fleet);
  const {links, late, cpu_s, uptime_s, refused} = page.fleet;
  for (const id of ["machine-title", "machine", "pause"]) byId(id).hidden = page.playing !== null;
  document.body.classList.toggle("alone", vehicles.length < 2);
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

// All vehicles that ask for attention, the gravest first, in words that change only when something happens.
function renderAlert(vehicles) {
  const now = page.now, known = vehicles.map((one) => now && now.vehicle === one.vehicle ? now : one);
  const found = known.filter(({level}) => ALARMS.includes(level));
  found.sort((a, b) => ALARMS.indexOf(a.level) - ALARMS.indexOf(b.level));
  const more = found.length > 4 ? `; ${found.length - 4} more` : "";
  byId("alert").hidden = !found.length;
  byId("alert").dataset.level = found.length ? found[0].level : "";
  text("alert", found.slice(0, 4).map((one) => `Vehicle ${one.vehicle}: ${brief(one)}`).join("; ") + more);
}

// What an empty page lacks: what to send where.
function renderEmpty({links, refused}) {
  const address = links.length ? links[0].address : "the detector's link", [kind, ...rest] = address.split(":");
  const place = rest.join(":").replace("0.0.0.0", location.hostname);
  text("address", address);
  figures("ways", kind === "udpin" ? [
    ["A vehicle by MAVProxy", `mavproxy.py --master=/dev/ttyACM0 --out=udp:${place}`],
    ["A vehicle by mavlink-router", `mavlink-routerd -e ${place} /dev/ttyACM0:921600`],
    ["No vehicle: the emulator", `sitl-plant run --out udpout:${place} --trajectory commanded`],
  ] : [["The detector's own side", `${address} is opened by the detector; the vehicle's side has to answer there`]]);
  const heard = links.length && links[0].connected ? "Somebody is there, but no autopilot was heard yet." : "Nothing was received yet.";
  text("heard", [heard, ...refused.map(([cause, count]) => `Refused: ${cause}, ${count} frames.`)].join(" "));
}

const clock = (s) => `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;

function renderReplay() {
  const {log, at_s, span_s, speed, spans, judged_s, wanted_s, done} = page.playing, scrub = byId("scrub");
  byId("replay").hidden = false;
  text("what", `replay of ${log}`);
  const shownAt = page.seek ?? wanted_s ?? at_s;
  text("time", `${clock(shownAt)} / ${clock(span_s)}`);
  scrub.max = String(span_s);
  if (page.seek === null && wanted_s === null) scrub.value = String(at_s);
  scrub.setAttribute("aria-valuetext", `${clock(shownAt)} of ${clock(span_s)}`);
  text("play", !speed ? "Play" : at_s >= span_s - 0.5 ? "Again" : "Pause");
  if (speed && document.activeElement !== byId("speed")) byId("speed").value = String(speed);
  text("judged", done ? "" : wanted_s === null ? `${Math.floor(100 * judged_s / span_s)} % judged` : "judging up to there");
  const key = JSON.stringify([spans, judged_s]);
  if (byId("spans").dataset.key === key) return;
  byId("spans").dataset.key = key;
  byId("spans").replaceChildren(...spans.map(([from_s, level], i) => {
    const until_s = i + 1 < spans.length ? spans[i + 1][0] : judged_s;
    const one = el("span", {data: {level}, title: `${clock(from_s)} ${NAMES[level]}`});
    one.style.left = `${100 * from_s / span_s}%`;
    one.style.width = `${100 * Math.max(0, until_s - from_s) / span_s}%`;
    return one;
  }));
}

function renderAbout() {
  const about = page.about, place = byId("airframe");
  place.replaceChildren();
  byId("figure").hidden = !about || !about.drawing;
  text("layout", about ? about.layout : "");
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
    el("h3", {}, `${slot.axis[0].toUpperCase()}${slot.axis.slice(1)}: measured less simulated rate `,
      el("span", {className: "fine"}, `rad/s; dashed: margin ±${shown(slot.margin)}`), el("span", {className: "value"})),
    el("canvas", {className: "residual", role: "img"}),
    el("h3", {}, "Time beyond the margin (FSD) ", el("span", {className: "fine"}, `s; dashed: limit ${shown(slot.threshold)} (FML)`), el("span", {className: "value"})),
    el("canvas", {className: "run", role: "img"}))));
}

function renderNow() {
  const now = page.now, level = now ? now.level : "none";
  byId("verdict").dataset.level = level;
  text("whose", page.vehicle === null ? "" : `Vehicle ${page.vehicle}${page.about && page.about.airframe ? `, ${page.about.airframe}` : ""}`);
  text("mark", MARKS[level] || "");
  text("level-text", now ? brief(now) : "waiting for figures");
  text("sentence", now ? now.sentence : "");
  text("advice", now ? now.advice : "");
  document.title = now ? `${brief(now)} – vehicle ${now.vehicle} – mavdiag` : "mavdiag detector";
  renderRotors(now);
  renderTrack(now ? now.track : []);
  figures("session", now ? [
    ...(now.since_s === null ? [] : [["Declared", `${span(now.since_s)} ago`]]),
    ["Judged", `${span(now.judged_s)} of ${span(now.flight_s)} of flight`],
    ["Alarms of single monitors", String(now.events)],
    ["Session", now.state],
  ] : []);
  byId("acknowledge").hidden = level !== "inspect" || page.playing !== null;
  renderAlert(page.fleet ? page.fleet.vehicles : []);
  if (!now) return figures("link-figures", []), figures("rates", []);
  renderBars(now);
  const {link} = now, total = link.received + link.lost;
  figures("link-figures", page.playing ? [["Profile", page.about ? page.about.profile : "–"]] : [
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

function renderTrack(track) {
  byId("place").hidden = track.length < 4;
  if (track.length < 4) return;
  drawTrack(byId("flown"), track);
  const [north, east] = track.slice(-2).map((metres, i) => `${Math.abs(metres).toFixed(1)} m ${["north south", "east west"][i].split(" ")[Number(metres < 0)]}`);
  byId("flown").setAttribute("aria-label", `now ${north} and ${east} of the origin`);
}

function renderBars(now) {
  const items = byId("bars").children;
  now.slots.forEach((slot, i) => {
    const item = items[i], about = page.about && page.about.slots[i];
    if (!item || !about) return;
    const [, figure, bar, reason] = item.children, judged = slot.value !== null;
    const ratio = judged ? slot.value / about.threshold : 0;
    item.dataset.state = !judged ? "idle" : ratio > 1 ? "over" : "under";
    const part = about.unit.match(/^(fraction|share) (of .*)/), factor = part ? 100 : 1; // as a report shows it
    const unit = part ? `% ${part[2]}` : about.unit.replace("^2", "²").replace(/^x /, "× ");
    const limit = `${shown(factor * about.threshold)} ${unit}`;
    text(figure, judged ? `${shown(factor * slot.value)} of ${limit}` : `threshold ${limit}`);
    const weak = about.decides ? "" : ", which alone raises a suspicion only";
    text(reason, judged ? (ratio > 1 ? `above its threshold${weak}` : "") : `not judged: ${slot.reason}`);
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
  for (const one of page.grown) if (one.row) text(one.row.lastChild, words(one));
  page.grown.clear();
  const added = fresh.reverse().map(row);
  byId("list").prepend(...added);
  setTimeout(() => { for (const one of added) one.dataset.painted = String(Date.now()); }); // after this frame
  const rows = byId("list").children;
  while (rows.length > ROWS_MOST) rows[rows.length - 1].remove();
  count();
}

function refilter() {
  page.fresh.length = 0;
  page.grown.clear();
  const found = [];
  for (let i = page.entries.length - 1; i >= 0 && found.length < ROWS_MOST; i -= 1) {
    if (wanted(page.entries[i])) found.push(row(page.entries[i]));
  }
  byId("list").replaceChildren(...found);
  count();
}

function count() {
  const shownRows = byId("list").children.length, folded = page.entries.length - page.entries.filter(wanted).length;
  const lost = page.lost ? `; ${page.lost} older ones were not kept` : "";
  text("events-count", `${page.total} received, ${shownRows} shown${folded ? `, ${folded} folded away` : ""}${lost}`);
}

// 2 an alert, 1 what matters, 0 the rest: sessions, notes, and alarms of monitors that decide nothing alone.
function weight(content) {
  if (isAlarm(content)) return (slotOf(content) || {decides: true}).decides ? 2 : 0;
  if (["state", "note", "suppressed"].includes(content.kind) || (content.kind === "text" && content.severity > NOTICE)) return 0;
  return loudness(content) ? 2 : 1;
}

const slotOf = ({monitor}) => page.about && page.about.slots.find((one) => one.name === monitor);

function wanted({content}) {
  if (!byId("all-vehicles").checked && content.vehicle !== null && content.vehicle !== page.vehicle) return false;
  return weight(content) >= Number(byId("detail").value);
}

function loudness(content) {
  if (content.kind === "text") return content.severity <= CRITICAL ? "critical" : content.severity <= WARNING ? "warning" : "";
  if (content.kind === "stage") return {fault: "critical", inspect: "warning", suspected: "warning"}[content.stage] || "";
  return isAlarm(content) ? "warning" : "";
}

function row(one) {
  const {number, content} = one, time = new Date(content.utc);
  const flown = page.playing && content.vehicle_s !== undefined;
  const at = flown ? clock(content.vehicle_s - page.playing.begin_s) : Number.isNaN(time.getTime()) ? "–" : time.toLocaleTimeString("en-GB");
  one.row = el("li", {data: {number: String(number), kind: content.kind, utc: content.utc, shown: String(Date.now()), loud: loudness(content)}},
    el("time", {dateTime: content.utc || "", title: content.utc || ""}, at),
    el("span", {className: "who"}, content.vehicle === null ? "" : `#${content.vehicle}`),
    el("span", {className: "kind"}, KINDS[content.kind] || content.kind),
    el("span", {className: "words"}, words(one)));
  return one.row;
}

const alarmName = (content) => `${(slotOf(content) || {label: content.monitor}).label}${content.axis ? ` ${content.axis}` : ""}`;

// One alarm, or all that followed each other.
function alarmWords({content, count: times, since, highest}) {
  const name = alarmName(content);
  const until = content.end_s ?? content.t_s, lasts = content.kind === "opened" || content.end_s === null;
  const most = `${highest.toFixed(highest < 9.95 ? 1 : 0)} times its threshold`, still = lasts ? ", it lasts" : "";
  if (times > 1) return `${name}: ${times} alarms in ${span(until - since)}, up to ${most}${still}`;
  return lasts ? `${name}: above its threshold${still}` : `${name}: ${most} for ${span(until - content.t_s)}`;
}

function words(one) {
  const {content} = one;
  switch (content.kind) {
    case "text": case "note": return String(content.text);
    case "suppressed": return `held back: ${content.text}`;
    case "state": return `${content.from} → ${content.to}: ${content.reason}`;
    case "stage": return brief({level: content.stage, rotor: content.rotor})
      + `${content.fault_kind ? ` (${content.fault_kind})` : ""}: ${content.reason}`
      + (content.monitor && ALARMS.includes(content.stage) ? `, ${alarmName(content)} ${ratioOf(content).toFixed(1)} times its threshold` : "");
    case "opened": case "event": return alarmWords(one);
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
  text("pause", page.paused ? "Go on" : "Hold");
  draw("strips");
});
byId("acknowledge").addEventListener("click", () => {
  if (page.vehicle !== null) fetch(`acknowledge?vehicle=${page.vehicle}`, {method: "POST"});
});
byId("detail").addEventListener("change", () => draw("filter"));
byId("all-vehicles").addEventListener("change", () => draw("filter"));
const play = (command) => fetch(`play?${command}`, {method: "POST"});

// Where the slider stands, ten times a second at most.
async function seek() {
  if (page.seeking) return;
  page.seeking = true;
  for (let at = page.seek; at !== null; at = page.seek === at ? null : page.seek) {
    await play(`at=${at}`);
    await new Promise((done) => setTimeout(done, 100));
  }
  page.seeking = false;
  page.seek = null;
}
byId("scrub").addEventListener("input", () => {
  page.seek = Number(byId("scrub").value);
  draw("replay");
  seek();
});
byId("play").addEventListener("click", async () => {
  const {at_s, span_s, speed} = page.playing;
  if (speed && at_s >= span_s - 0.5) return play("at=0");
  return play(`speed=${speed ? 0 : byId("speed").value}`);
});
byId("speed").addEventListener("change", () => play(`speed=${byId("speed").value}`));
window.addEventListener("resize", () => draw("now", "strips"));
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw("now", "strips"));
connect();
