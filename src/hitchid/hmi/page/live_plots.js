/** The live plots: one a group of signals, redrawn at most once an animation frame and only when something is new. */
import { byId, write } from "./dom.js";
import { LiveData } from "./live_data.js";
import { makePlot, plotBox } from "./plot.js";
import { axisTimes, chooseAxis, onAxis } from "./resample.js";
import { onThemeChange, SERIES } from "./theme.js";

const GROUPS = [
  { group: "displacement", title: "Displacement" },
  { group: "command", title: "Commands" },
  { group: "speed", title: "Speed" },
  { group: "pressure", title: "Pressures" },
  { group: "other", title: "Other signals" },
];
/** Drawn in this order, beneath the measurement. */
const PREDICTIONS = [
  { label: "", stroke: "band", width: 0, of: "freeRun", column: 3 },
  { label: "", stroke: "band", width: 0, of: "freeRun", column: 2 },
  { label: "free run", stroke: "teal", of: "freeRun", column: 1 },
  { label: "one second ahead", stroke: "accent", of: "ahead", column: 1 },
];
const LATENCIES = 500;
const AHEAD_S = 1; // the prediction one second ahead reaches beyond the newest sample

export class LivePlots {
  stats = { frames: 0, latency_ms: /** @type {number[]} */ ([]) };
  /** @type {LiveData|null} */ data = null;
  /** @type {LiveData|null} */ past = null;
  /** @type {number|null} */ cursor = null;
  #plots = [];
  #asked = false;
  #drawnWallMs = NaN;
  #host = byId("plots");

  /** @param {import("./view.js").View} view @param {() => any} status @param {(time: number|null) => void} moved */
  constructor(view, status, moved) {
    this.view = view;
    this.status = status;
    this.moved = moved;
    view.addEventListener("change", () => this.ask());
    onThemeChange(() => this.ask());
    new ResizeObserver(() => this.#resize()).observe(this.#host);
  }

  /** Begin with the signals of a source. @param {any} source of the status, or null */
  begin(source) {
    for (const { plot } of this.#plots) plot.destroy();
    this.#plots = [];
    this.#host.replaceChildren();
    this.past = null;
    this.data = source && new LiveData(source);
    if (!source) return;
    const signals = source.signals.map((signal, index) => ({ ...signal, column: index + 1 }));
    const groups = GROUPS.filter(({ group }) => signals.some((signal) => signal.group === group));
    for (const { group, title } of groups) {
      this.#add(group, title, signals.filter((signal) => signal.group === group), group === groups.at(-1).group);
    }
    this.#resize();
    this.ask();
  }

  /** The span that is shown, s. */
  span() {
    return this.view.span(this.data?.measured.last ?? 0, this.data?.ahead.length ? AHEAD_S : 0);
  }

  /** Draw in the next animation frame. */
  ask() {
    if (this.#asked) return;
    this.#asked = true;
    requestAnimationFrame(() => {
      this.#asked = false;
      this.#draw();
    });
  }

  /** Put the cursor of all plots at a time. @param {number|null} time s */
  setCursor(time) {
    const first = this.#plots[0]?.plot;
    if (!first) return;
    const left = time == null ? -10 : first.valToPos(time, "x");
    for (const { plot } of this.#plots) plot.setCursor({ left, top: time == null ? -10 : 5 }, false);
    this.#moved(time);
  }

  #moved(time) {
    this.cursor = time;
    this.moved(time);
  }

  /** @param {string} group @param {string} title @param {any[]} signals @param {boolean} lowest: it has the time axis of all */
  #add(group, title, signals, lowest) {
    const main = group === "displacement";
    const measured = signals.map(({ label, column }, index) => ({
      label: signals.length > 1 ? label : "measured", stroke: SERIES[index % SERIES.length], of: "measured", column,
    })).reverse();
    const traces = main ? [...PREDICTIONS, { label: "target", stroke: "rose", dash: [6, 4], of: "measured", column: this.data.targetColumn }, ...measured] : measured;
    const content = {
      title, unit: signals[0].unit, lines: traces.map(({ of, column, ...line }) => line), band: main ? [1, 2] : undefined, main, lowest,
      zoomed: (from, to) => this.view.show({ from, to }),
      reset: () => this.view.follow(),
      moved: (time) => this.#moved(time),
      markers: () => this.status()?.markers ?? [],
    };
    const { box, host } = plotBox(content, group);
    this.#host.append(box);
    this.#plots.push({ plot: makePlot(content, host), host, traces });
  }

  #resize() {
    for (const { plot, host } of this.#plots) {
      if (host.clientWidth && (plot.width !== host.clientWidth || plot.height !== host.clientHeight)) {
        plot.setSize({ width: host.clientWidth, height: host.clientHeight });
      }
    }
  }

  #draw() {
    if (!this.data || !this.#host.clientWidth) return;
    const { from, to } = this.span();
    const axis = chooseAxis(from, to, this.data.step, this.#plots[0].plot.bbox.width / devicePixelRatio);
    const times = axisTimes(axis);
    for (const { plot, traces } of this.#plots) {
      const values = traces.map(({ of, column }) => onAxis({ ring: this.#ring(of), column }, axis));
      plot.batch(() => {
        plot.setData([times, ...values], false);
        plot.setScale("x", { min: from, max: to });
      });
    }
    queueMicrotask(() => this.#drawn()); // uPlot draws in a microtask of its own, before this one
  }

  /** @param {string} of */
  #ring(of) {
    return of === "measured" && this.view.fixed && this.past ? this.past.measured : this.data[of];
  }

  #drawn() {
    this.stats.frames += 1;
    const { plot } = this.#plots[0];
    if (this.cursor != null) this.cursor = plot.posToVal(plot.cursor.left, "x"); // it stays in its place while the axis moves
    const { wallMs } = this.data;
    if (wallMs === this.#drawnWallMs || Number.isNaN(wallMs)) return;
    this.#drawnWallMs = wallMs;
    this.stats.latency_ms.push(Date.now() - wallMs);
    if (this.stats.latency_ms.length > LATENCIES) this.stats.latency_ms.shift();
  }
}

/** @param {{from: number, to: number}} span @param {boolean} following */
export function showSpan({ from, to }, following) {
  const digits = to - from < 20 ? 2 : 0;
  write(byId("span"), following ? "" : `${from.toFixed(digits)} s to ${to.toFixed(digits)} s`);
}
