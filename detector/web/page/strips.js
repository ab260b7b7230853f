// Drawn on canvases: the residual between its margins and the run length against its limit, and where the vehicle was.
"use strict";

const SPAN_S = 20;
const BIN_S = 0.05; // as detector.web.snapshot.BIN_NS

// The points of one axis, by bin: [bin, low, high, fsd, judged].
class Trace {
  constructor() {
    this.points = [];
  }

  add(strip) {
    strip.bins.forEach((bin, i) => {
      const point = [bin, strip.low[i], strip.high[i], strip.fsd_s[i], strip.judged[i]];
      const last = this.points[this.points.length - 1];
      if (last && bin < last[0]) this.points.length = 0; // the vehicle started anew
      if (last && bin === last[0]) {
        last[1] = Math.min(last[1], point[1]);
        last[2] = Math.max(last[2], point[2]);
        last[3] = Math.max(last[3], point[3]);
        last[4] = last[4] || point[4];
      } else {
        this.points.push(point);
      }
    });
    const newest = this.newest();
    let old = 0;
    while (old < this.points.length && this.points[old][0] < newest - SPAN_S / BIN_S) old += 1;
    this.points.splice(0, old);
  }

  newest() {
    return this.points.length ? this.points[this.points.length - 1][0] : 0;
  }
}

function colours() {
  const style = getComputedStyle(document.documentElement);
  const one = (name) => style.getPropertyValue(name).trim();
  return {
    ink: one("--ink-soft"), grid: one("--line"), residual: one("--residual"), limit: one("--limit"),
    over: one("--fault"), idle: one("--idle"),
  };
}

// A canvas made as sharp as the screen; returns its context and size in CSS pixels.
function sharp(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "11px system-ui, sans-serif";
  return [context, width, height];
}

const LEFT = 46, RIGHT = 8, TOP = 8, BOTTOM = 20;

// The next round figure from a value on, so that an axis has round ends and changes seldom.
function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [1, 1.5, 2, 3, 4, 5, 6, 8, 10].find((one) => one * power >= value * (1 - 1e-9));
}

function frame(context, width, height, low, high, colour) {
  const y = (value) => TOP + (height - TOP - BOTTOM) * (high - value) / (high - low);
  const x = (age_s) => width - RIGHT - (width - LEFT - RIGHT) * age_s / SPAN_S;
  context.lineWidth = 1;
  context.fillStyle = colour.ink;
  context.strokeStyle = colour.grid;
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const value of low < 0 ? [low, low / 2, 0, high / 2, high] : [0, high / 2, high]) {
    context.beginPath();
    context.moveTo(LEFT, y(value));
    context.lineTo(width - RIGHT, y(value));
    context.stroke();
    context.fillText(String(Number(value.toPrecision(3))).replace("-", "−"), LEFT - 6, y(value));
  }
  context.textBaseline = "top";
  for (let age = 0; age <= SPAN_S; age += 5) {
    context.textAlign = age === 0 ? "right" : "center";
    context.fillText(age === 0 ? "now" : `−${age} s`, x(age), height - BOTTOM + 5);
  }
  return [x, y];
}

function shown(value) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const text = size === 0 ? "0" : size >= 100 ? value.toFixed(0) : size >= 1 ? value.toFixed(2) : value.toPrecision(2);
  return text.replace("-", "−");
}

function limitLine(context, width, at, colour) {
  context.strokeStyle = colour.limit;
  context.lineWidth = 2;
  context.setLineDash([6, 4]);
  context.beginPath();
  context.moveTo(LEFT, at);
  context.lineTo(width - RIGHT, at);
  context.stroke();
  context.setLineDash([]);
}

// The residual as a band from its least to its greatest value, vermilion where it leaves the margins.
function drawResidual(canvas, trace, margin) {
  const [context, width, height] = sharp(canvas), colour = colours();
  const most = trace.points.reduce((all, one) => Math.max(all, Math.abs(one[1]), Math.abs(one[2])), 0);
  const reach = roundUp(Math.max(1.6 * margin, most));
  const [x, y] = frame(context, width, height, -reach, reach, colour);
  const newest = trace.newest();
  let before = null;
  for (const point of trace.points) {
    const [bin, low, high, , judged] = point;
    const over = judged && Math.max(-low, high) > margin;
    context.fillStyle = !judged ? colour.idle : over ? colour.over : colour.residual;
    const wide = Math.max(1.5, (width - LEFT - RIGHT) * BIN_S / SPAN_S);
    const joined = before && before[0] === bin - 1; // the line goes on where the last bin's ended
    const top = y(joined ? Math.max(high, before[1]) : high);
    const tall = Math.max(1.5, y(joined ? Math.min(low, before[2]) : low) - top);
    before = point;
    context.fillRect(x((newest - bin) * BIN_S) - wide, top, wide + 0.6, tall);
  }
  limitLine(context, width, y(margin), colour);
  limitLine(context, width, y(-margin), colour);
}

// The run length FSD as steps from zero, vermilion above the limit FML.
function drawRun(canvas, trace, limit) {
  const [context, width, height] = sharp(canvas), colour = colours();
  const most = trace.points.reduce((all, one) => Math.max(all, one[3]), 0);
  const reach = roundUp(Math.max(1.2 * limit, most));
  const [x, y] = frame(context, width, height, 0, reach, colour);
  const newest = trace.newest();
  for (const [bin, , , fsd, judged] of trace.points) {
    context.fillStyle = !judged ? colour.idle : fsd > limit ? colour.over : colour.residual;
    const wide = Math.max(1.5, (width - LEFT - RIGHT) * BIN_S / SPAN_S);
    context.fillRect(x((newest - bin) * BIN_S) - wide, y(fsd), wide + 0.6, Math.max(1, y(0) - y(fsd)));
  }
  limitLine(context, width, y(limit), colour);
}

// Where the vehicle was, north up and to scale. track: [north, east, north, east, ...] in metres, the newest last.
function drawTrack(canvas, track) {
  const [context, width, height] = sharp(canvas), colour = colours(), points = [];
  for (let i = 0; i < track.length; i += 2) points.push([track[i], track[i + 1]]);
  const ends = [0, 1].map((k) => [Math.min(...points.map((one) => one[k])), Math.max(...points.map((one) => one[k]))]);
  const metres = Math.max(2, ...ends.map(([low, high]) => high - low)), edge = 22;
  const scale = (Math.min(width, height) - 2 * edge) / metres, [north, east] = ends.map(([low, high]) => (low + high) / 2);
  const at = (point) => [width / 2 + scale * (point[1] - east), height / 2 - scale * (point[0] - north)];
  context.strokeStyle = colour.residual;
  context.lineWidth = 1.5;
  context.lineJoin = "round";
  context.beginPath();
  for (const point of points) context.lineTo(...at(point));
  context.stroke();
  context.fillStyle = colour.residual;
  context.beginPath();
  context.arc(...at(points[points.length - 1]), 4.5, 0, 2 * Math.PI);
  context.fill();
  const bar = roundUp(metres / 4.5); // about a quarter of the picture
  context.fillStyle = context.strokeStyle = colour.ink;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(8, height - 5);
  context.lineTo(8 + bar * scale, height - 5);
  context.stroke();
  context.textAlign = "left";
  context.textBaseline = "bottom";
  context.fillText(`${Number(bar.toPrecision(3))} m`, 8, height - 8);
  context.textAlign = "right";
  context.textBaseline = "top";
  context.fillText("N ↑", width - 6, 4);
}
