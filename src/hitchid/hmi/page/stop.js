/** Stop and reset: a button and the Escape key, always enabled, for viewers too. */
import { byId } from "./dom.js";

/** @param {import("./connection.js").Connection} connection */
export function bindStop(connection) {
  const stop = () => connection.order("stop");
  const button = byId("stop");
  button.addEventListener("pointerdown", stop); // at the press, not at the release
  button.addEventListener("click", (event) => event.detail === 0 && stop()); // by keyboard or a screen reader
  bindEscape(stop);
  byId("reset").addEventListener("click", () => connection.order("reset"));
  // A report in a frame keeps the keys to itself: the page takes the focus back while the hitch can move.
  const takeFocus = () => {
    if (document.activeElement?.tagName === "IFRAME" && connection.canMove) byId("stop").focus();
  };
  window.addEventListener("blur", () => setTimeout(takeFocus));
  connection.addEventListener("change", takeFocus);
}

/**
 * Escape stops at its press. An open list of a select keeps the press to itself; then its release stops.
 * @param {() => void} stop
 */
function bindEscape(stop) {
  let pressed = false;
  window.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    if (!event.repeat) stop();
    pressed = true;
  }, true);
  window.addEventListener("keyup", (event) => {
    if (event.key !== "Escape") return;
    if (!pressed) stop();
    pressed = false;
  }, true);
}
