/** Colours of the plots, from the style sheet, so that light and dark are written once. */

const DARK = matchMedia("(prefers-color-scheme: dark)");
/** @type {Map<string, string>} asked from the style sheet once: every plot asks for each colour in every frame */
const known = new Map();
DARK.addEventListener("change", () => known.clear());

/** @param {string} name of a custom property, without the two hyphens */
export function colour(name) {
  if (!known.has(name)) known.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  return known.get(name);
}

/** Call when light changes to dark or back. @param {() => void} redraw */
export function onThemeChange(redraw) {
  DARK.addEventListener("change", redraw);
}

/** Colours of one group of signals or curves, in their order. */
export const SERIES = ["ink", "orange", "violet", "ochre", "teal", "rose"];
