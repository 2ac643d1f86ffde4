"use strict";
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

function drawAxes(context, scale, [low, high], last) {
  const { x, y, right, bottom } = scale;
  context.strokeStyle = colour("--grid");
  context.fillStyle = colour("--ink");
  context.lineWidth = 1;
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const [value, text] of ticks(low, high, last === "large" ? 6 : 3)) {
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
  drawAxes(context, scale, bounds, plot === "displacement" ? "large" : "small");
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

const number = (value) => (Number.isFinite(value) ? value.toPrecision(6) : "diverged");

function writeReadout() {
  const unit = content.unit;
  const rows = [["time", "time / s", test.time[cursor]]];
  test.commands.forEach((command, i) => rows.push([`command-${i}`, command.label, command.values[cursor]]));
  rows.push(["measured", `measured / ${unit}`, test.measured[cursor]]);
  for (const model of test.models.filter((each) => shown.get(each.key)))
    rows.push([model.key, `${model.label} / ${unit}`, model.values[cursor], model.error[cursor]]);
  if (test.band && shown.get("free_run")) {
    rows.push(["band-lower", `band of the free run, lower end / ${unit}`, test.band[0][cursor]]);
    rows.push(["band-upper", `band of the free run, upper end / ${unit}`, test.band[1][cursor]]);
  }
  byId("readout").replaceChildren(...rows.map(([key, title, value, error]) => {
    const row = document.createElement("tr");
    row.dataset.signal = key;
    const name = document.createElement("th");
    name.scope = "row";
    name.textContent = title;
    const cells = [value, error].map((each) => {
      const cell = document.createElement("td");
      cell.className = "number";
      cell.textContent = each === undefined ? "" : number(each);
      return cell;
    });
    row.append(name, ...cells);
    return row;
  }));
}

let pending = false;
function draw() { // once a frame, however many events there were
  if (pending || test === null) return;
  pending = true;
  requestAnimationFrame(() => {
    pending = false;
    canvases.forEach(drawPlot);
    byId("range").textContent = `${range[0].toFixed(2)} … ${range[1].toFixed(2)} s`;
    writeReadout();
  });
}

const ends = () => [test.time[0], test.time[test.time.length - 1]];

function show(from, to) {
  const [start, stop] = ends();
  const least = Math.min(stop - start, MIN_SAMPLES * (test.time[1] - test.time[0]));
  const length = Math.min(Math.max(to - from, least), stop - start);
  const first = Math.min(Math.max(from + (to - from - length) / 2, start), stop - length);
  range = [first, first + length];
  draw();
}

function zoom(factor, around) {
  show(around - (around - range[0]) / factor, around + (range[1] - around) / factor);
}
const pan = (share) => {
  const [start, stop] = ends();
  const way = share * (range[1] - range[0]);
  const bounded = Math.min(Math.max(way, start - range[0]), stop - range[1]);
  show(range[0] + bounded, range[1] + bounded);
};
const reset = () => show(...ends());

function moveCursor(index) {
  cursor = Math.min(Math.max(index, 0), test.time.length - 1);
  const time = test.time[cursor];
  if (time < range[0]) pan((time - range[0]) / (range[1] - range[0]));
  if (time > range[1]) pan((time - range[1]) / (range[1] - range[0]));
  draw();
}

function timeAt(canvas, clientX) {
  const box = canvas.getBoundingClientRect();
  const share = (clientX - box.left - MARGIN.left) / (box.width - MARGIN.left - MARGIN.right);
  return range[0] + Math.min(Math.max(share, 0), 1) * (range[1] - range[0]);
}

for (const canvas of canvases) {
  const offset = (event) => event.clientX - canvas.getBoundingClientRect().left;
  canvas.addEventListener("pointerdown", (event) => {
    if (test === null || event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    moveCursor(indexAt(timeAt(canvas, event.clientX)));
    if (event.pointerType !== "touch") drag = { from: offset(event), to: offset(event), x: event.clientX };
  });
  canvas.addEventListener("pointermove", (event) => {
    if (test === null) return;
    if (drag !== null) drag.to = offset(event);
    moveCursor(indexAt(timeAt(canvas, event.clientX)));
  });
  canvas.addEventListener("pointerup", (event) => {
    if (drag === null) return;
    const times = [drag.x, event.clientX].map((x) => timeAt(canvas, x)).sort((a, b) => a - b);
    const isClick = Math.abs(drag.to - drag.from) < CLICK_PX;
    drag = null;
    if (isClick) draw(); else show(...times);
  });
  canvas.addEventListener("pointercancel", () => { drag = null; draw(); });
  canvas.addEventListener("dblclick", reset);
  canvas.addEventListener("wheel", (event) => {
    if (test === null) return;
    event.preventDefault();
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) pan(event.deltaX / canvas.clientWidth);
    else zoom(event.deltaY < 0 ? ZOOM : 1 / ZOOM, timeAt(canvas, event.clientX));
  }, { passive: false });
}

plots.addEventListener("keydown", (event) => {
  if (test === null || event.ctrlKey || event.metaKey || event.altKey) return;
  const [first, last] = [indexAt(range[0]), indexAt(range[1])];
  const step = event.shiftKey ? Math.max(1, Math.round((last - first) / 10)) : 1;
  const at = Math.min(Math.max(test.time[cursor], range[0]), range[1]);
  const actions = {
    ArrowLeft: () => moveCursor(cursor - step), ArrowRight: () => moveCursor(cursor + step),
    Home: () => moveCursor(0), End: () => moveCursor(test.time.length - 1),
    "+": () => zoom(ZOOM, at), "=": () => zoom(ZOOM, at), "-": () => zoom(1 / ZOOM, at),
    PageUp: () => pan(-0.5), PageDown: () => pan(0.5), Escape: reset,
  };
  if (!(event.key in actions)) return;
  event.preventDefault();
  actions[event.key]();
});

const middle = () => Math.min(Math.max(test.time[cursor], range[0]), range[1]);
const buttons = { in: () => zoom(ZOOM, middle()), out: () => zoom(1 / ZOOM, middle()), left: () => pan(-0.5), right: () => pan(0.5), reset };
for (const [id, action] of Object.entries(buttons)) byId(id).addEventListener("click", action);

function option(text, value) {
  const element = document.createElement("option");
  element.textContent = text;
  element.value = value;
  return element;
}

function svgElement(name, attributes) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

function legendKey({ colour: name, dash, width = 2.5 }) {
  const key = svgElement("svg", { class: "key", "aria-hidden": "true" });
  const ends = { x1: 0, x2: "100%", y1: "50%", y2: "50%" };
  const style = { stroke: `var(${name})`, "stroke-width": width, "stroke-dasharray": dash.join(" ") || "none" };
  key.append(svgElement("line", { ...ends, ...style }));
  return key;
}

function modelToggle(model) {
  const toggle = document.createElement("label");
  const box = document.createElement("input");
  box.type = "checkbox";
  box.checked = shown.get(model.key);
  box.addEventListener("change", () => { shown.set(model.key, box.checked); draw(); });
  toggle.append(box, legendKey(model), model.label);
  return toggle;
}

function caption(id, title, lines) {
  const keys = lines.map((line) => {
    const entry = document.createElement("span");
    entry.append(legendKey(line), line.label);
    return entry;
  });
  byId(id).replaceChildren(title, ...keys);
}

function openTest() {
  const raw = content.sections[byId("section").value][Number(byId("test").value)];
  test = decodeTest(raw);
  for (const model of test.models) if (!shown.has(model.key)) shown.set(model.key, model.shown);
  byId("models").replaceChildren(byId("models").querySelector("legend"), ...test.models.map(modelToggle));
  caption("displacement-label", `Displacement / ${content.unit}, time / s`, [MEASURED()]);
  caption("error-label", `Error, measured minus predicted / ${content.unit}`, []);
  caption("command-label", "Command", test.commands);
  cursor = Math.floor(test.time.length / 2);
  reset();
}

function openSection() {
  const tests = content.sections[byId("section").value];
  byId("test").replaceChildren(...tests.map((each, i) => option(each.name, String(i))));
  openTest();
}

byId("section").addEventListener("change", openSection);
byId("test").addEventListener("change", openTest);
new ResizeObserver(draw).observe(plots);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
const sections = Object.keys(content.sections || {});
byId("section").replaceChildren(...sections.map((name) => option(name, name)));
if (sections.length) openSection();
