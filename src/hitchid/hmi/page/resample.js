/**
 * Several ring buffers onto one time axis for a plot.
 *
 * Where the plot has a pixel for every sample, the axis has every sample. Else it has bins of a whole number of samples,
 * each with its lowest and its highest value in the order in which they came, so that no peak is lost. Bins lie at
 * multiples of their width, so that a moving window does not shimmer.
 */

/**
 * @typedef {{ring: import("./ring_buffer.js").RingBuffer, column: number}} Trace
 * @typedef {{step: number, binned: boolean, first: number, count: number}} Axis
 */

/** @param {number} from s @param {number} to s @param {number} step s, of the samples @param {number} pixels @returns {Axis} */
export function chooseAxis(from, to, step, pixels) {
  const samplesPerBin = Math.ceil((to - from) / step / Math.max(pixels, 50));
  const width = samplesPerBin * step;
  const first = Math.floor(from / width);
  return { step: width, binned: samplesPerBin > 1, first, count: Math.max(1, Math.ceil(to / width) - first + 1) };
}

/** Times of an axis, s. @param {Axis} axis @returns {number[]} */
export function axisTimes({ step, binned, first, count }) {
  const times = [];
  for (let bin = 0; bin < count; bin += 1) {
    if (binned) times.push((first + bin + 0.25) * step, (first + bin + 0.75) * step);
    else times.push((first + bin) * step);
  }
  return times;
}

/** Values of a trace on an axis; null where there is none. @param {Trace} trace @param {Axis} axis @returns {(number|null)[]} */
export function onAxis(trace, axis) {
  return axis.binned ? extremes(trace, axis) : samples(trace, axis);
}

/** @param {Trace} trace @param {Axis} axis */
function samples({ ring, column }, { step, first, count }) {
  const values = new Array(count).fill(null);
  for (let row = ring.rowAt((first - 0.5) * step); row < ring.length; row += 1) {
    const at = ring.place(row) * ring.columns;
    const bin = Math.round(ring.values[at] / step) - first;
    if (bin >= count) break;
    const value = ring.values[at + column];
    if (bin >= 0 && value === value) values[bin] = value;
  }
  return values;
}

/** @param {Trace} trace @param {Axis} axis */
function extremes({ ring, column }, { step, first, count }) {
  const values = new Array(2 * count).fill(null);
  let bin = -1;
  let low = 0;
  let high = 0;
  let rising = true;
  const close = () => {
    if (bin < 0) return;
    values[2 * bin] = rising ? low : high;
    values[2 * bin + 1] = rising ? high : low;
  };
  for (let row = ring.rowAt(first * step); row < ring.length; row += 1) {
    const at = ring.place(row) * ring.columns;
    const value = ring.values[at + column];
    if (value !== value) continue;
    const here = Math.floor(ring.values[at] / step + 1e-6) - first;
    if (here >= count) break;
    if (here !== bin) {
      close();
      bin = here;
      low = value;
      high = value;
    } else if (value > high) {
      high = value;
      rising = true;
    } else if (value < low) {
      low = value;
      rising = false;
    }
  }
  close();
  return values;
}
