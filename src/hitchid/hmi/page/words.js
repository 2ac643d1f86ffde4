/** Numbers and durations as the operator reads them. */

/** @param {number|null|undefined} seconds */
export function duration(seconds) {
  if (seconds == null || !Number.isFinite(seconds)) return "";
  if (seconds < 100) return `${Math.max(0, Math.round(seconds))} s`;
  const minutes = Math.round(seconds / 60);
  return minutes < 100 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

/** Digits after the point that a signal of this unit is read with. */
const DIGITS = { mm: 2, cm: 3, m: 4, deg: 2, A: 3, V: 3, percent: 1, "%": 1, bar: 1, MPa: 2, "mm/s": 1, "m/s": 3 };

/** @param {number|null|undefined} value @param {string} unit */
export function number(value, unit) {
  if (value == null || !Number.isFinite(value)) return "–";
  const text = value.toFixed(DIGITS[unit] ?? 3).replace("-", "−");
  return /^−0\.?0*$/.test(text) ? text.slice(1) : text;
}

/** A change, with its sign. @param {number} value @param {string} unit */
export function change(value, unit) {
  const text = number(value, unit);
  return `${value > 0 && /[1-9]/.test(text) ? "+" : ""}${text} ${unitText(unit)}`.trim();
}

/** Text of a unit; the unit "1" is a pure number. @param {string} unit */
export const unitText = (unit) => (unit === "1" ? "" : unit === "percent" ? "%" : unit);

/** A name that the list does not have yet: the stem, then stem-2, stem-3. @param {string} stem @param {{name: string}[]} [items] */
export function freshName(stem, items) {
  const taken = new Set((items ?? []).map((item) => item.name));
  let name = stem;
  for (let n = 2; taken.has(name); n += 1) name = `${stem}-${n}`;
  return name;
}

/** Today as in 2026-03-31. */
export function today() {
  const now = new Date();
  return new Date(now.getTime() - now.getTimezoneOffset() * 60_000).toISOString().slice(0, 10);
}
