/** The newest rows of a table, in one array of fixed size. The first column is time and does not fall. */
export class RingBuffer {
  /** @param {number} columns @param {number} capacity rows */
  constructor(columns, capacity) {
    this.columns = columns;
    this.capacity = capacity;
    this.length = 0;
    this.values = new Float64Array(columns * capacity);
    this.start = 0;
  }

  clear() {
    this.length = 0;
    this.start = 0;
  }

  /** Place of a row in `values`, in rows; row 0 is the oldest. @param {number} row */
  place(row) {
    return (this.start + row) % this.capacity;
  }

  /** @param {number} row */
  time(row) {
    return this.values[this.place(row) * this.columns];
  }

  get first() {
    return this.length ? this.time(0) : NaN;
  }

  get last() {
    return this.length ? this.time(this.length - 1) : NaN;
  }

  /** @param {number} column @returns {number} the newest value */
  newest(column) {
    return this.length ? this.values[this.place(this.length - 1) * this.columns + column] : NaN;
  }

  /**
   * Append rows of `width` values; columns beyond `width` are filled with `rest`.
   * @param {Float64Array} rows
   * @param {number} width
   * @param {number} [rest]
   */
  push(rows, width, rest = NaN) {
    for (let offset = 0; offset + width <= rows.length; offset += width) {
      const at = this.place(this.length) * this.columns;
      for (let c = 0; c < this.columns; c += 1) this.values[at + c] = c < width ? rows[offset + c] : rest;
      if (this.length < this.capacity) this.length += 1;
      else this.start = (this.start + 1) % this.capacity;
    }
  }

  /** The first row whose time is not before `time`, by bisection. @param {number} time */
  rowAt(time) {
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time(middle) < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}
