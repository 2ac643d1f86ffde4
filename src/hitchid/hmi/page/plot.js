/** One uPlot chart of a group of signals, with calm axes. */
import { element } from "./dom.js";
import { colour } from "./theme.js";
import { unitText } from "./words.js";

const { uPlot } = /** @type {any} */ (window);
const FONT = '12px system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif';
const PAD = 0.08; // of the range, above and below
const SHRINK = 0.45; // the axis shrinks when less of it than this is used

/**
 * A range of an axis that grows at once and shrinks seldom, so that the scale does not jitter.
 * @param {number} low @param {number} high @param {[number, number]|null} before @param {number} least height of the range
 * @returns {[number, number]}
 */
export function calmRange(low, high, before, least) {
  const height = Math.max(high - low, least);
  const middle = (low + high) / 2;
  const from = middle - height * (0.5 + PAD);
  const to = middle + height * (0.5 + PAD);
  if (before && low >= before[0] && high <= before[1] && to - from > SHRINK * (before[1] - before[0])) return before;
  const step = 10 ** Math.floor(Math.log10(to - from)) / 5;
  return [Math.floor(from / step) * step, Math.ceil(to / step) * step];
}

/** Least height of an axis, in its unit, so that noise at rest is not blown up. */
const LEAST = { mm: 4, A: 0.2, "mm/s": 4, bar: 4, percent: 5, deg: 2 };

/**
 * @typedef {{label: string, stroke: string, width?: number, dash?: number[]}} Line
 * @typedef {{title: string, unit: string, lines: Line[], band?: [number, number], main: boolean, lowest: boolean,
 *   zoomed: (from: number, to: number) => void, reset: () => void, moved: (time: number|null) => void,
 *   markers: () => {time_s: number, text: string}[]}} Content
 */

/** @param {Content} content @param {HTMLElement} host @returns {any} uPlot */
export function makePlot(content, host) {
  let range = null;
  const axis = { stroke: () => colour("muted"), font: FONT, grid: { stroke: () => colour("grid"), width: 1 }, ticks: { show: false } };
  const plot = new uPlot({
    width: Math.max(host.clientWidth, 100),
    height: Math.max(host.clientHeight, 60),
    legend: { show: false },
    padding: [6, 16, 0, 0],
    scales: {
      x: { time: false },
      y: { range: (_, low, high) => (range = low == null ? [0, 1] : calmRange(low, high, range, LEAST[content.unit] ?? 0.01)) },
    },
    axes: [
      { ...axis, size: content.lowest ? 22 : 4, gap: 3, values: (_, ticks) => ticks.map((tick) => (content.lowest ? `${tick} s` : "")) },
      { ...axis, size: 52, gap: 4, space: 26 },
    ],
    cursor: {
      y: false,
      sync: { key: "live" },
      drag: { x: true, y: false, setScale: false },
      points: { size: 6 },
      bind: { dblclick: () => () => { content.reset(); return null; } },
    },
    series: [{}, ...content.lines.map((line) => ({ width: 1.5, ...line, stroke: () => colour(line.stroke), points: { show: false } }))],
    bands: content.band ? [{ series: content.band, fill: () => colour("band") }] : [],
    hooks: {
      setSelect: [(u) => select(u, content)],
      setCursor: [(u) => content.moved(u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null)],
      draw: [(u) => drawMarkers(u, content.markers(), content.main)],
    },
  }, [[], ...content.lines.map(() => [])], host);
  return plot;
}

/** @param {any} u @param {Content} content */
function select(u, content) {
  const { left, width } = u.select;
  if (width < 4) return;
  content.zoomed(u.posToVal(left, "x"), u.posToVal(left + width, "x"));
  u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
}

/** @param {any} u @param {{time_s: number, text: string}[]} markers @param {boolean} named */
function drawMarkers(u, markers, named) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = colour("marker");
  ctx.lineWidth = devicePixelRatio;
  ctx.textAlign = "left";
  ctx.textBaseline = "top";
  ctx.font = FONT.replace("12px", `${12 * devicePixelRatio}px`);
  ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
  for (const { time_s, text } of markers) {
    const x = u.valToPos(time_s, "x", true);
    if (x < bbox.left || x > bbox.left + bbox.width) continue;
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    if (named) ctx.fillText(text, x + 4 * devicePixelRatio, bbox.top + 2 * devicePixelRatio);
  }
  ctx.restore();
}

/** A box with title, legend and place of a plot. @param {Content} content @param {string} kind */
export function plotBox(content, kind) {
  const host = element("div", { class: "host" });
  const keys = [...content.lines].reverse().filter(({ label }) => label).map(({ label, stroke, dash }) =>
    element("li", { class: `key ${stroke}${dash ? " dashed" : ""}` }, label));
  if (content.band) keys.push(element("li", { class: "key area" }, "90 % band"));
  const unit = unitText(content.unit);
  const title = element("h3", {}, content.title, unit ? `, ${unit}` : "");
  const box = element("div", { class: `plot ${kind}` }, element("div", { class: "caption" }, title, element("ul", { class: "legend" }, ...keys)), host);
  return { box, host };
}
