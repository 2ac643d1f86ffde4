/** The project folder: what it contains, uploads, links for viewers. */
import { byId, element, write } from "./dom.js";
import { get, post, request } from "./http.js";
import { showReport } from "./identify.js";

const MOST_BYTES = 5_000_000; // the server refuses more

export class Project extends EventTarget {
  /** @type {any} */ content = {};

  /** @param {import("./connection.js").Connection} connection */
  constructor(connection) {
    super();
    this.connection = connection;
    connection.addEventListener("project_changed", () => this.read());
  }

  async read() {
    try {
      this.content = await get("/api/project");
      this.dispatchEvent(new Event("change"));
    } catch (error) {
      this.connection.problem(error.message, "project");
    }
  }
}

/** @param {import("./connection.js").Connection} connection @param {Project} project */
export function bindProject(connection, project) {
  project.addEventListener("change", () => listAll(project.content));
  connection.addEventListener("greeted", ({ detail }) => write(byId("version"), `hitchid ${detail.version}. `
    + (detail.allow_output ? "Output to hardware is allowed." : "Output to hardware is not allowed: only a virtual bench moves.")));
  byId("upload-form").addEventListener("submit", (event) => {
    event.preventDefault();
    upload(connection, byId("upload").files[0]);
  });
  byId("link").addEventListener("click", async () => {
    try {
      byId("link-text").value = (await post("/api/link", {})).link;
      byId("link-label").hidden = false;
      byId("link-text").select();
    } catch (error) {
      connection.problem(error.message);
    }
  });
}

/** @param {import("./connection.js").Connection} connection @param {File} file */
async function upload(connection, file) {
  if (file.size > MOST_BYTES) {
    connection.problem(`${file.name} has ${(file.size / 1e6).toFixed(1)} MB; 5 MB are allowed. Shorten it or lower its sampling rate.`);
    return;
  }
  try {
    await request(`/api/upload?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
    write(byId("upload-note"), `${file.name} is in uploads/. Run it under Campaign, as commands from a file.`);
    byId("upload").value = "";
  } catch (error) {
    connection.problem(error.message);
  }
}

const LISTS = [
  { key: "campaigns", title: "Campaigns", folder: "campaigns/" },
  { key: "models", title: "Models", folder: "models/" },
  { key: "reports", title: "Reports", folder: "reports/" },
  { key: "controllers", title: "Controllers", folder: "controllers/" },
  { key: "drives", title: "Drives", folder: "drives/" },
  { key: "recordings", title: "Recordings", folder: "recordings/" },
  { key: "uploads", title: "Uploads", folder: "uploads/" },
  { key: "changes", title: "Change logs of adaptation", folder: "changes/" },
];

/** @param {any} content */
function listAll(content) {
  const shown = byId("lists").querySelector("#project-report") ?? element("div", { id: "project-report", class: "stack" });
  byId("lists").replaceChildren(shown, element("div", { class: "card lists" }, ...LISTS.map(({ key, title, folder }) => list(title, folder, content[key] ?? [], content.most, shown))));
}

/** @param {string} title @param {string} folder @param {any[]} items @param {number} most that the server tells @param {HTMLElement} place of a report */
function list(title, folder, items, most, place) {
  const rows = items.map((item) => element("tr", {},
    element("th", { scope: "row" }, item.name),
    element("td", {}, item.logs == null ? "" : `${item.logs} logs`),
    element("td", { class: "when" }, (item.changed ?? "").slice(0, 16).replace("T", " ")),
    element("td", {}, item.report ? element("button", { type: "button", class: "quiet", "aria-label": `Show report ${item.name}`, click: () => {
      showReport(place, item.report, item.name);
      place.scrollIntoView({ block: "center" });
    } }, "Report") : "")));
  const body = rows.length ? element("table", { class: "items" }, element("caption", { class: "unseen" }, title), element("tbody", {}, ...rows))
    : element("p", { class: "note" }, "none yet");
  const note = items.length < most ? [] : [element("p", { class: "note" }, `The newest ${most}; the folder has more.`)];
  return element("section", {}, element("h3", {}, title, " ", element("code", {}, folder)), body, ...note);
}
