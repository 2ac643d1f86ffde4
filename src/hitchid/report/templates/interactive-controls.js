// Second half of the script: read-out, pointer, keyboard and choices.

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
