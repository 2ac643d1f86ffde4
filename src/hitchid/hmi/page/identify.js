/** Identify a model from a campaign, watch search and training, validate it, read the report. */
import { byId, choices, element, fill } from "./dom.js";
import { freshName } from "./words.js";

/**
 * @param {import("./connection.js").Connection} connection
 * @param {import("./project.js").Project} project
 * @param {import("./jobs.js").Jobs} jobs
 */
export function bindIdentify(connection, project, jobs) {
  project.addEventListener("change", () => {
    const { campaigns, models } = project.content;
    fill(byId("identify-logs"), choices(campaigns), "no campaign yet: run one first");
    fill(byId("validate-logs"), choices(campaigns), "no campaign yet: run one first");
    fill(byId("validate-model"), choices(models), "no model yet: identify one first");
    proposeNames(project);
  });
  for (const id of ["identify-logs", "validate-model"]) byId(id).addEventListener("change", () => proposeNames(project));
  for (const id of ["identify-name", "validate-name"]) byId(id).addEventListener("input", ({ target }) => (target.dataset.changed = "yes"));
  bindForms(jobs);
  const started = () => (byId("identify-empty").hidden = true);
  jobs.show("identify", byId("identify-job"), "Identification", (job, ended) => {
    started();
    if (ended && job.state === "done") choose(byId("validate-model"), job.out, project);
  });
  jobs.show("validate", byId("validate-job"), "Validation", (job) => {
    started();
    if (job.state === "done" && job.out) {
      showReport(byId("report"), `/files/${job.out}/report.html`, job.out);
      byId("report").scrollIntoView({ block: "start" });
    }
  });
}

/** @param {import("./jobs.js").Jobs} jobs */
function bindForms(jobs) {
  byId("identify-form").addEventListener("submit", (event) => {
    event.preventDefault();
    byId("identify-name").dataset.changed = "";
    jobs.start({ kind: "identify", logs: byId("identify-logs").value, name: byId("identify-name").value.trim(), brief: byId("identify-brief").checked });
  });
  byId("validate-form").addEventListener("submit", (event) => {
    event.preventDefault();
    byId("validate-name").dataset.changed = "";
    jobs.start({ kind: "validate", model: byId("validate-model").value, logs: byId("validate-logs").value, name: byId("validate-name").value.trim() });
  });
}

/** @param {import("./project.js").Project} project */
function proposeNames({ content }) {
  const propose = (field, path, items) => {
    if (!field.dataset.changed && path) field.value = freshName(path.split("/").pop(), items);
  };
  propose(byId("identify-name"), byId("identify-logs").value, content.models);
  propose(byId("validate-name"), byId("validate-model").value, content.reports);
}

/** Choose a path in a list, after the project was read. @param {HTMLSelectElement} select @param {string} path @param {import("./project.js").Project} project */
export async function choose(select, path, project) {
  await project.read();
  select.value = path;
  select.dispatchEvent(new Event("change"));
}

/** @param {HTMLElement} place @param {string} address @param {string} title */
export function showReport(place, address, title) {
  if (place.querySelector("iframe")?.getAttribute("src") === address) return;
  const frame = element("iframe", { src: address, title: `Report ${title}`, "data-testid": "report-frame" });
  place.replaceChildren(element("p", { class: "open" }, element("a", { href: address, target: "_blank", rel: "noopener" }, "Open the report in a tab of its own")), frame);
}
