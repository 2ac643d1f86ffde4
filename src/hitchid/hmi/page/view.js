/** The span of time that is shown: it follows the newest sample, or stands where the operator put it. */

const SHORTEST_S = 0.2;
const ZOOM = 2;
const SHIFT = 0.25; // of the span

export class View extends EventTarget {
  window = 60;
  /** @type {{from: number, to: number}|null} */ fixed = null;

  /** @param {number} newest s @param {number} ahead s that predictions reach beyond it */
  span(newest, ahead) {
    if (this.fixed) return this.fixed;
    const to = Math.max(this.window, (Number.isFinite(newest) ? newest : 0) + ahead); // a short log begins at the left
    return { from: to - this.window, to };
  }

  /** @param {number} seconds */
  follow(seconds = this.window) {
    this.window = seconds;
    this.#set(null);
  }

  /** @param {{from: number, to: number}} span */
  show({ from, to }) {
    const middle = (from + to) / 2;
    const half = Math.max(to - from, SHORTEST_S) / 2;
    this.#set({ from: middle - half, to: middle + half });
  }

  /** @param {{from: number, to: number}} span now shown @param {-1|1} way 1: closer @param {number} [around] s */
  zoom({ from, to }, way, around = (from + to) / 2) {
    const factor = ZOOM ** -way;
    this.show({ from: around - (around - from) * factor, to: around + (to - around) * factor });
  }

  /** @param {{from: number, to: number}} span now shown @param {-1|1} way 1: later */
  shift({ from, to }, way) {
    const by = way * SHIFT * (to - from);
    this.show({ from: from + by, to: to + by });
  }

  /** @param {{from: number, to: number}|null} fixed */
  #set(fixed) {
    this.fixed = fixed;
    this.dispatchEvent(new Event("change"));
  }
}
