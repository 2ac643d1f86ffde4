/** Binary frames: uint32 kind, rows, columns, 0; float64 wall_ms; then rows of float64; little endian. */

const HEADER_BYTES = 24;

export const MEASURED = 0;
export const FREE_RUN = 1;
export const ONE_SECOND_AHEAD = 2;

/**
 * @typedef {{kind: number, rows: number, columns: number, wallMs: number, values: Float64Array}} Frame
 * @param {ArrayBuffer} buffer
 * @returns {Frame}
 */
export function readFrame(buffer) {
  const view = new DataView(buffer);
  const rows = view.getUint32(4, true);
  const columns = view.getUint32(8, true);
  return {
    kind: view.getUint32(0, true),
    rows,
    columns,
    wallMs: view.getFloat64(16, true),
    values: new Float64Array(buffer, HEADER_BYTES, rows * columns),
  };
}
