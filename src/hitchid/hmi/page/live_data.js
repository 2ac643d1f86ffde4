/** What the live plots draw: the measured signals with the target, and both predictions, as ring buffers. */
import { FREE_RUN, MEASURED, ONE_SECOND_AHEAD } from "./frames.js";
import { RingBuffer } from "./ring_buffer.js";

const BUFFERED_S = 600; // the longest window
const MOST_ROWS = 60_000; // 600 s at 100 Hz; 4 MB for six signals
const PREDICTION_COLUMNS = 4; // time, displacement, lower, upper

export class LiveData {
  /** @param {{signals: any[], step_s: number}} source */
  constructor(source) {
    const rows = Math.min(MOST_ROWS, Math.ceil(BUFFERED_S / source.step_s));
    this.step = source.step_s;
    this.signals = source.signals;
    this.targetColumn = source.signals.length + 1;
    this.measured = new RingBuffer(source.signals.length + 2, rows);
    this.freeRun = new RingBuffer(PREDICTION_COLUMNS, rows);
    this.ahead = new RingBuffer(PREDICTION_COLUMNS, rows);
    this.wallMs = NaN;
  }

  /**
   * @param {import("./frames.js").Frame} frame
   * @param {number} target mm, NaN for none
   */
  add(frame, target) {
    const ring = this.#ring(frame.kind);
    if (!ring || frame.rows === 0) return;
    if (frame.values[0] < ring.last - this.step) this.#restart(frame.kind, ring);
    ring.push(frame.values, frame.columns, target);
    if (frame.kind === MEASURED) this.wallMs = frame.wallMs;
  }

  /** Put older rows before those that came live. @param {import("./frames.js").Frame} history */
  prepend(history) {
    const { measured } = this;
    const live = [];
    for (let row = 0; row < measured.length; row += 1) {
      const at = measured.place(row) * measured.columns;
      live.push(...measured.values.subarray(at, at + measured.columns));
    }
    const first = measured.first;
    measured.clear();
    let rows = 0;
    while (rows < history.rows && !(history.values[rows * history.columns] >= first)) rows += 1;
    measured.push(history.values.subarray(0, rows * history.columns), history.columns);
    measured.push(Float64Array.from(live), measured.columns);
  }

  /** @param {number} kind */
  #ring(kind) {
    return { [MEASURED]: this.measured, [FREE_RUN]: this.freeRun, [ONE_SECOND_AHEAD]: this.ahead }[kind];
  }

  /** Time went back: a new free run, or the source began anew. @param {number} kind @param {RingBuffer} ring */
  #restart(kind, ring) {
    ring.clear();
    if (kind === MEASURED) {
      this.freeRun.clear();
      this.ahead.clear();
    }
  }
}
