/** The live section: frames into the plots and the values, and the tools over them. */
import { byId, element, write } from "./dom.js";
import { MEASURED, readFrame } from "./frames.js";
import { request } from "./http.js";
import { LiveData } from "./live_data.js";
import { LivePlots, showSpan } from "./live_plots.js";
import { number, unitText } from "./words.js";
import { View } from "./view.js";

const VALUES_MS = 200; // values that change faster cannot be read
const HISTORY_POINTS = 6000;
const HISTORY_WAIT_MS = 200;

/** @param {import("./connection.js").Connection} connection @returns {LivePlots} */
export function bindLive(connection) {
  const view = new View();
  const plots = new LivePlots(view, () => connection.status, () => showValues(plots));
  let shown = null;
  connection.addEventListener("greeted", () => (shown = null)); // what was missed is read again
  connection.addEventListener("change", () => {
    const { source } = connection.status ?? {};
    const key = source ? JSON.stringify([source.name, source.signals, source.step_s]) : "";
    if (key !== shown) {
      shown = key;
      plots.begin(source);
      listValues(source);
      view.follow();
    }
    write(byId("mode"), connection.status?.mode ? `Mode: ${connection.status.mode}` : "");
    byId("live-empty").hidden = Boolean(source);
    byId("live").dataset.empty = String(!source);
  });
  connection.addEventListener("frame", ({ detail }) => receive(plots, connection, detail));
  setInterval(() => showValues(plots), VALUES_MS);
  bindTools(plots, view);
  bindHistory(plots, view);
  return plots;
}

/** @param {LivePlots} plots @param {import("./connection.js").Connection} connection @param {import("./frames.js").Frame} frame */
function receive(plots, connection, frame) {
  const { data } = plots;
  if (!data) return;
  if (frame.kind === MEASURED && data.measured.length === 0 && frame.values[0] > 1) fillUp(data, frame.values[0]);
  data.add(frame, connection.status?.target_mm ?? NaN);
  if (frame.kind === MEASURED && !plots.view.fixed) plots.ask(); // predictions are drawn with the next measurement
}

/** A page that was opened later asks for what it missed. @param {LiveData} data @param {number} to s */
async function fillUp(data, to) {
  const frame = await history(Math.max(0, to - 600), to);
  if (frame) data.prepend(frame);
}

/** @param {number} from s @param {number} to s */
async function history(from, to) {
  try {
    const answer = await request(`/api/history?from=${from.toFixed(3)}&to=${to.toFixed(3)}&points=${HISTORY_POINTS}`);
    return readFrame(await answer.arrayBuffer());
  } catch {
    return null; // the plot then shows what the page has
  }
}

/** A span that begins before the buffered samples is read from the server. @param {LivePlots} plots @param {View} view */
function bindHistory(plots, view) {
  let timer = 0;
  view.addEventListener("change", () => {
    clearTimeout(timer);
    plots.past = null;
    showSpan(plots.span(), !view.fixed);
    if (!view.fixed || !plots.data || view.fixed.to < 0) return;
    const { from, to } = view.fixed;
    if (from >= plots.data.measured.first || plots.data.measured.first <= plots.data.step) return;
    timer = setTimeout(async () => {
      const { data } = plots;
      const frame = await history(Math.max(0, from), to);
      if (!frame || view.fixed?.from !== from || data !== plots.data) return;
      plots.past = new LiveData({ signals: data.signals, step_s: data.step });
      plots.past.add(frame, NaN);
      plots.ask();
    }, HISTORY_WAIT_MS);
  });
}

/** @param {any} source */
function listValues(source) {
  byId("values").replaceChildren(...(source?.signals ?? []).map(({ label, unit }) =>
    element("div", {}, element("dt", {}, label), element("dd", {}, element("span", {}, "–"), " ", element("small", {}, unitText(unit))))));
}

/** The values at the cursor, else the newest ones. @param {LivePlots} plots */
function showValues(plots) {
  const { data, cursor } = plots;
  if (!data) {
    write(byId("values-at"), "");
    return;
  }
  const ring = (plots.view.fixed && plots.past ? plots.past : data).measured;
  const row = cursor == null ? ring.length - 1 : ring.rowAt(cursor - data.step / 2);
  const at = row >= 0 && row < ring.length ? ring.place(row) * ring.columns : NaN; // beyond the samples there is no value
  byId("values").querySelectorAll("dd > span").forEach((node, index) => {
    write(node, number(ring.values[at + index + 1], data.signals[index].unit));
  });
  const time = cursor ?? ring.last;
  write(byId("values-at"), Number.isNaN(time) ? "" : cursor == null ? `newest, at ${time.toFixed(1)} s` : `at the cursor, ${time.toFixed(2)} s`);
}

/** @param {LivePlots} plots @param {View} view */
function bindTools(plots, view) {
  const actions = {
    pause: () => (view.fixed ? view.follow() : view.show(plots.span())),
    closer: () => view.zoom(plots.span(), 1, around(plots)),
    farther: () => view.zoom(plots.span(), -1, around(plots)),
    earlier: () => view.shift(plots.span(), -1),
    later: () => view.shift(plots.span(), 1),
    newest: () => {
      plots.setCursor(null);
      view.follow();
    },
  };
  byId("pause").addEventListener("click", actions.pause);
  byId("zoom-in").addEventListener("click", actions.closer);
  byId("zoom-out").addEventListener("click", actions.farther);
  byId("earlier").addEventListener("click", actions.earlier);
  byId("later").addEventListener("click", actions.later);
  for (const input of document.querySelectorAll('input[name="window"]')) {
    input.addEventListener("change", () => view.follow(Number(input.value)));
    input.addEventListener("click", () => view.follow(Number(input.value)));
  }
  view.addEventListener("change", () => {
    byId("pause").setAttribute("aria-pressed", String(view.fixed != null));
    write(byId("pause"), view.fixed ? "Go on live" : "Pause");
  });
  const keys = { "+": actions.closer, "=": actions.closer, "-": actions.farther, " ": actions.pause, Home: actions.newest };
  byId("plots").addEventListener("keydown", (event) => {
    const arrow = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    const action = arrow ? () => (event.shiftKey ? view.shift(plots.span(), arrow) : moveCursor(plots, arrow)) : keys[event.key];
    if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    action();
  });
}

/** Zoom keeps the cursor in its place, else the middle. @param {LivePlots} plots */
const around = (plots) => plots.cursor ?? undefined;

/** @param {LivePlots} plots @param {number} way */
function moveCursor(plots, way) {
  const { from, to } = plots.span();
  const step = Math.max(plots.data?.step ?? 0, (to - from) / 200);
  const start = plots.cursor ?? Math.min(to, plots.data?.measured.last ?? to);
  plots.setCursor(Math.min(to, Math.max(from, start + way * step)));
}
