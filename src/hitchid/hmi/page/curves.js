/** Curves of search and training: one chart a quantity, on a logarithmic axis, lifting and lowering together. */
import { element } from "./dom.js";
import { colour, onThemeChange, SERIES } from "./theme.js";

const { uPlot } = /** @type {any} */ (window);
const HEIGHT = 180;
const FONT = '12px system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif';

export class Curves {
  box = element("div", { class: "curves" });
  /** @type {Map<string, any>} */ #charts = new Map();
  #state = "";

  constructor() {
    new ResizeObserver(() => this.#resize()).observe(this.box);
    onThemeChange(() => this.#charts.forEach(({ plot }) => plot.redraw(false)));
  }

  /** @param {Record<string, [number, number][]>} curves */
  update(curves) {
    const state = JSON.stringify(Object.entries(curves).map(([name, points]) => [name, points.length]));
    if (state === this.#state) return;
    this.#state = state;
    const quantities = grouped(curves);
    for (const [quantity, chart] of this.#charts) {
      if (quantities.get(quantity)?.map(({ label }) => label).join() === chart.labels) continue;
      chart.plot.destroy();
      chart.figure.remove();
      this.#charts.delete(quantity);
    }
    for (const [quantity, lines] of quantities) {
      if (!this.#charts.has(quantity)) this.#charts.set(quantity, this.#make(quantity, lines));
      const { plot, newest } = this.#charts.get(quantity);
      plot.setData(uPlot.join(lines.map(({ points }) => [points.map(([x]) => x), points.map(([, y]) => (y > 0 ? y : null))])));
      newest.textContent = lines.map(({ label, points }) => `${label} ${points.at(-1)?.[1].toPrecision(3) ?? "–"}`).join(", ");
    }
  }

  /** @param {string} quantity @param {{label: string}[]} lines */
  #make(quantity, lines) {
    const newest = element("span", { class: "newest" });
    const keys = lines.map(({ label }, index) => element("li", { class: `key ${SERIES[index % SERIES.length]}` }, label));
    const host = element("div", { class: "host", "aria-hidden": "true" });
    const figure = element("figure", {}, element("figcaption", { class: "caption" }, element("h4", {}, quantity),
      element("ul", { class: "legend" }, ...keys), newest), host);
    this.box.append(figure);
    const axis = { stroke: () => colour("muted"), font: FONT, grid: { stroke: () => colour("grid"), width: 1 }, ticks: { show: false } };
    const plot = new uPlot({
      width: Math.max(host.clientWidth, 100), height: HEIGHT, legend: { show: false }, cursor: { show: false }, padding: [6, 16, 0, 0],
      scales: { x: { time: false }, y: { distr: 3 } },
      axes: [{ ...axis, size: 22, gap: 3 }, { ...axis, size: 56, gap: 4, values: (_, ticks) => ticks.map((tick) => (tick == null ? "" : String(Number(tick.toPrecision(3))))) }],
      series: [{}, ...lines.map((_, index) => ({ stroke: () => colour(SERIES[index % SERIES.length]), width: 1.5, spanGaps: true, points: { show: false } }))],
    }, [[], ...lines.map(() => [])], host);
    return { plot, host, figure, newest, labels: lines.map(({ label }) => label).join() };
  }

  #resize() {
    for (const { plot, host } of this.#charts.values()) {
      if (host.clientWidth && plot.width !== host.clientWidth) plot.setSize({ width: host.clientWidth, height: HEIGHT });
    }
  }
}

/** "lifting rmse" is the quantity "rmse" of lifting. @param {Record<string, [number, number][]>} curves */
function grouped(curves) {
  /** @type {Map<string, {label: string, points: [number, number][]}[]>} */
  const quantities = new Map();
  for (const [name, points] of Object.entries(curves)) {
    const [, direction, rest] = /^(lifting|lowering)\s+(.+)$/.exec(name) ?? [];
    const quantity = rest ?? name;
    quantities.set(quantity, [...(quantities.get(quantity) ?? []), { label: direction ?? name, points }]);
  }
  return quantities;
}
