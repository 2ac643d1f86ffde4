"use strict"; // first half of the script: data and drawing

const content = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const plots = byId("plots");
const canvases = [...document.querySelectorAll("canvas")];
const MARGIN = { left: 58, right: 8, top: 6, bottom: 22 }; // around the axes, CSS px
const MIN_SAMPLES = 8; // shown at the largest zoom
const ZOOM = 1.3; // factor of one step of the wheel or a key
const CLICK_PX = 5; // a shorter drag is a click

let test = null; // decoded test
let range = [0, 1]; // first and last shown time, s
let cursor = 0; // sample
let drag = null; // pixel range of a drag, { from, to }
const shown = new Map(); // model key to whether it is drawn

function decode(text) {
  if (text === null) return null;
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  return Float32Array.from({ length: bytes.length / 4 }, (_, i) => view.getFloat32(4 * i, true));
}

function decodeTest(raw) {
  const measured = decode(raw.measured);
  const subtract = (values) => (values === null ? null : measured.map((y, i) => y - values[i]));
  const models = raw.models.map((model) => {
    const values = decode(model.values);
    return { ...model, values, error: subtract(values) };
  });
  const commands = raw.commands.map((command) => ({ ...command, values: decode(command.values), dash: [] }));
  const band = raw.band === null ? null : raw.band.map(decode);
  const run = models.find((model) => model.key === "free_run");
  const centred = band && run && band.map((end) => end.map((y, i) => y - run.values[i]));
  return { name: raw.name, time: decode(raw.time), measured, models, commands, band, errorBand: centred };
}

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Wide and light, so that it is seen below the predictions.
const MEASURED = () => ({ label: "measured", values: test.measured, colour: "--faint", dash: [], width: 4 });

// Lines and band of each plot; a line is { values, colour, dash, width }.
function layers(plot) {
  // Dashed lines last, so that what lies below is seen.
  const drawn = test.models.filter((m) => shown.get(m.key)).sort((a, b) => a.dash.length - b.dash.length);
  const line = (model, values) => ({ values, colour: model.colour, dash: model.dash, width: 1.4 });
  if (plot === "command") return { band: null, lines: test.commands.map((c) => line(c, c.values)) };
  const runShown = shown.get("free_run");
  if (plot === "error")
    return { band: runShown ? test.errorBand : null, lines: drawn.map((m) => line(m, m.error)) };
  return { band: runShown ? test.band : null, lines: [MEASURED(), ...drawn.map((m) => line(m, m.values))] };
}

function indexAt(time) { // of the sample nearest to a time
  const times = test.time;
  let [low, high] = [0, times.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle; else high = middle;
  }
  return time - times[low] <= times[high] - time ? low : high;
}

function visible() { // samples to draw: those shown and one more on either side
  const last = test.time.length - 1;
  return [Math.max(0, indexAt(range[0]) - 1), Math.min(last, indexAt(range[1]) + 1)];
}

function extent(allValues, first, last) {
  let [low, high] = [Infinity, -Infinity];
  for (const values of allValues)
    for (let i = first; i <= last; i++)
      if (Number.isFinite(values[i])) { low = Math.min(low, values[i]); high = Math.max(high, values[i]); }
  if (low > high) return [0, 1];
  const room = 0.05 * (high - low) || 0.5 * Math.abs(high) || 0.5;
  return [low - room, high + room];
}

function ticks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough);
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const list = [];
  for (let i = Math.ceil(low / step); i * step <= high + 1e-9 * step; i++)
    list.push([i * step, (i * step).toFixed(decimals)]);
  return list;
}

function scales(canvas, [low, high]) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const [right, bottom] = [width - MARGIN.right, height - MARGIN.bottom];
  const x = (time) => MARGIN.left + ((time - range[0]) / (range[1] - range[0])) * (right - MARGIN.left);
  const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - MARGIN.top);
  return { x, y, right, bottom, width, height };
}

// Points of a curve: every sample, or the lowest and the highest of each pixel column, in their order.
function points(values, first, last, { x, y, right }) {
  const list = [];
  if (last - first < 2 * (right - MARGIN.left)) {
    for (let i = first; i <= last; i++)
      list.push(Number.isFinite(values[i]) ? [x(test.time[i]), y(values[i])] : null);
    return list;
  }
  let i = first;
  while (i <= last) {
    const column = Math.floor(x(test.time[i]));
    let [lowest, highest, gap] = [-1, -1, false];
    for (; i <= last && Math.floor(x(test.time[i])) === column; i++) {
      if (!Number.isFinite(values[i])) { gap = true; continue; }
      if (lowest < 0 || values[i] < values[lowest]) lowest = i;
      if (highest < 0 || values[i] > values[highest]) highest = i;
    }
    if (lowest >= 0)
      for (const k of [Math.min(lowest, highest), Math.max(lowest, highest)])
        list.push([x(test.time[k]), y(values[k])]);
    if (gap) list.push(null);
  }
  return list;
}

function stroke(context, list) {
  context.beginPath();
  let down = false;
  for (const point of list) {
    if (point === null) { down = false; continue; }
    if (down) context.lineTo(...point); else context.moveTo(...point);
    down = true;
  }
  context.stroke();
}

function drawAxes(context, scale, [low, high], rows) {
  const { x, y, right, bottom } = scale;
  context.strokeStyle = colour("--grid");
  context.fillStyle = colour("--ink");
  context.lineWidth = 1;
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const [value, text] of ticks(low, high, rows)) {
    stroke(context, [[MARGIN.left, y(value)], [right, y(value)]]);
    context.fillText(text, MARGIN.left - 6, y(value));
  }
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const [value, text] of ticks(range[0], range[1], Math.max(2, (right - MARGIN.left) / 90))) {
    stroke(context, [[x(value), MARGIN.top], [x(value), bottom]]);
    const half = context.measureText(text).width / 2;
    context.fillText(text, Math.min(x(value), scale.width - half - 1), bottom + 5);
  }
}

function drawBand(context, band, first, last, scale) {
  const [lower, upper] = band.map((values) => points(values, first, last, scale).filter(Boolean));
  if (!lower.length) return;
  context.beginPath();
  lower.forEach((point) => context.lineTo(...point));
  upper.reverse().forEach((point) => context.lineTo(...point));
  context.globalAlpha = 0.22;
  context.fillStyle = colour("--greybox");
  context.fill();
  context.globalAlpha = 1;
}

function drawPlot(canvas) {
  const plot = canvas.dataset.plot;
  const ratio = window.devicePixelRatio || 1;
  const context = canvas.getContext("2d");
  canvas.width = Math.round(ratio * canvas.clientWidth);
  canvas.height = Math.round(ratio * canvas.clientHeight);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.font = '12px system-ui, "DejaVu Sans", sans-serif';
  const [first, last] = visible();
  const { band, lines } = layers(plot);
  const bounds = extent([...lines.map((line) => line.values), ...(band || [])], first, last);
  const scale = scales(canvas, bounds);
  drawAxes(context, scale, bounds, plot === "displacement" ? 8 : 4);
  context.save();
  context.beginPath();
  context.rect(MARGIN.left, MARGIN.top, scale.right - MARGIN.left, scale.bottom - MARGIN.top);
  context.clip();
  if (band) drawBand(context, band, first, last, scale);
  for (const line of lines) {
    context.strokeStyle = colour(line.colour);
    context.lineWidth = line.width;
    context.setLineDash(line.dash);
    stroke(context, points(line.values, first, last, scale));
  }
  context.setLineDash([]);
  context.strokeStyle = colour("--ink");
  const at = scale.x(test.time[cursor]);
  stroke(context, [[at, MARGIN.top], [at, scale.bottom]]);
  if (drag !== null) {
    context.globalAlpha = 0.15;
    context.fillStyle = colour("--ink");
    context.fillRect(drag.from, MARGIN.top, drag.to - drag.from, scale.bottom - MARGIN.top);
  }
  context.restore();
}
