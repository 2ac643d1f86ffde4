/** The sections of the page, one at a time, by the fragment of the address. */
import { byId } from "./dom.js";

const SECTIONS = ["bench", "campaign", "identify", "drive", "project"];

export function bindSections() {
  const show = () => {
    const asked = location.hash.slice(1);
    const section = SECTIONS.includes(asked) ? asked : "bench";
    document.body.dataset.section = section;
    for (const name of SECTIONS) byId(`panel-${name}`).hidden = name !== section;
    byId("panel-audit").hidden = section !== "campaign";
    for (const link of document.querySelectorAll("nav a")) {
      if (link.hash === `#${section}`) link.setAttribute("aria-current", "page");
      else link.removeAttribute("aria-current");
    }
    scrollTo(0, 0);
  };
  window.addEventListener("hashchange", show);
  show();
}
