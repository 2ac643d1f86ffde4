/** Colours of the plots, from the style sheet, so that light and dark are written once. */

/** @param {string} name of a custom property, without the two hyphens */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** Call when light changes to dark or back. @param {() => void} redraw */
export function onThemeChange(redraw) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

/** Colours of one group of signals or curves, in their order. */
export const SERIES = ["ink", "orange", "violet", "ochre", "teal", "rose"];
