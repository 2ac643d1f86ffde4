/** Messages of errors under the header, shown until dismissed. */
import { byId, element } from "./dom.js";

const MOST = 4; // a longer stack would cover the plots

/** @param {import("./connection.js").Connection} connection */
export function showProblems(connection) {
  const list = byId("problems");
  connection.addEventListener("problem", ({ detail: { text, topic = "" } }) => {
    for (const old of [...list.children]) {
      if ((topic && old.dataset.topic === topic) || old.dataset.text === text) old.remove();
    }
    if (!text) return;
    const dismiss = element("button", { type: "button", class: "quiet", click: () => item.remove() }, "Dismiss");
    const item = element("div", { class: "problem", "data-testid": "problem", "data-topic": topic, "data-text": text },
      element("span", { class: "sign", "aria-hidden": "true" }, "!"), element("p", {}, text), dismiss);
    list.append(item);
    if (list.children.length > MOST) list.firstElementChild.remove();
  });
}
