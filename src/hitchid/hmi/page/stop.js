/** Stop and reset: a button and the Escape key, always enabled, for viewers too. */
import { byId } from "./dom.js";

/** @param {import("./connection.js").Connection} connection */
export function bindStop(connection) {
  const stop = () => connection.order("stop");
  const button = byId("stop");
  button.addEventListener("pointerdown", stop); // at the press, not at the release
  button.addEventListener("click", (event) => event.detail === 0 && stop()); // by keyboard or a screen reader
  window.addEventListener("keydown", (event) => event.key === "Escape" && !event.repeat && stop(), true);
  byId("reset").addEventListener("click", () => connection.order("reset"));
  // A report in a frame keeps the keys to itself: the page takes the focus back while the hitch can move.
  const takeFocus = () => {
    if (document.activeElement?.tagName === "IFRAME" && connection.canMove) byId("stop").focus();
  };
  window.addEventListener("blur", () => setTimeout(takeFocus));
  connection.addEventListener("change", takeFocus);
}
