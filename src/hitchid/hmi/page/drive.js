/** Tune a controller from a model, and drive the hitch to a target with it. */
import { byId, choices, fill, write } from "./dom.js";
import { whatMoves, whyNot } from "./header.js";
import { choose } from "./identify.js";
import { freshName, number, today } from "./words.js";

/**
 * @param {import("./connection.js").Connection} connection
 * @param {import("./project.js").Project} project
 * @param {import("./jobs.js").Jobs} jobs
 */
export function bindDrive(connection, project, jobs) {
  project.addEventListener("change", () => {
    fill(byId("tune-model"), choices(project.content.models), "no model yet: identify one first");
    fill(byId("drive-controller"), choices(project.content.controllers), "no controller yet: tune one first");
    proposeNames(project);
    showDrive(connection);
  });
  byId("tune-model").addEventListener("change", () => proposeNames(project));
  for (const id of ["tune-name", "drive-name"]) byId(id).addEventListener("input", ({ target }) => (target.dataset.changed = "yes"));
  connection.addEventListener("change", () => showDrive(connection));
  bindTune(project, jobs);
  bindOrders(connection);
  bindTarget(connection);
  showDrive(connection);
}

/** @param {import("./project.js").Project} project */
function proposeNames({ content }) {
  const model = byId("tune-model").value.split("/").pop();
  if (model && !byId("tune-name").dataset.changed) byId("tune-name").value = freshName(model, content.controllers);
  if (!byId("drive-name").dataset.changed) byId("drive-name").value = freshName(`drive-${today()}`, content.drives);
}

/** @param {import("./project.js").Project} project @param {import("./jobs.js").Jobs} jobs */
function bindTune(project, jobs) {
  byId("tune-form").addEventListener("submit", (event) => {
    event.preventDefault();
    byId("tune-name").dataset.changed = "";
    jobs.start({ kind: "tune", model: byId("tune-model").value, name: byId("tune-name").value.trim() });
  });
  jobs.show("tune", byId("tune-job"), "Tuning", (job, ended) => {
    const done = job.state === "done";
    byId("tune-report").hidden = !done;
    if (done) byId("tune-report").href = `/files/${job.out.replace(/\.toml$/, "")}-report/report.html`;
    if (ended && done) choose(byId("drive-controller"), job.out, project);
  });
}

/** @param {import("./connection.js").Connection} connection */
function bindOrders(connection) {
  byId("drive-form").addEventListener("submit", (event) => {
    event.preventDefault();
    byId("drive-name").dataset.changed = "";
    connection.order("arm", { plan: { kind: "drive", name: byId("drive-name").value.trim(), controller: byId("drive-controller").value } });
  });
  byId("drive-start").addEventListener("click", () => connection.order("start"));
}

/** Slider and number are one value; at most one order is under way. @param {import("./connection.js").Connection} connection */
function bindTarget(connection) {
  const slider = byId("target");
  const field = byId("target-number");
  let wanted = null;
  let sending = false;
  const send = async () => {
    if (sending) return;
    sending = true;
    while (wanted != null) {
      const mm = wanted;
      wanted = null;
      await connection.order("target", { mm });
    }
    sending = false;
  };
  slider.addEventListener("input", () => {
    field.value = slider.value;
    wanted = Number(slider.value);
    send();
  });
  field.addEventListener("change", () => {
    if (field.value === "" || !field.reportValidity()) return;
    slider.value = field.value;
    wanted = Number(field.value);
    send();
  });
  field.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault(); // Enter sets the target; it must not arm
    field.dispatchEvent(new Event("change"));
  });
}

/** @param {import("./connection.js").Connection} connection */
function showDrive(connection) {
  const { status } = connection;
  const reason = whyNot(connection);
  const driving = status?.run?.kind === "drive" && connection.canMove;
  const armed = driving && status.state === "armed";
  byId("drive-arm").disabled = Boolean(reason) || status?.state === "armed" || !byId("drive-controller").value;
  byId("drive-start").disabled = !armed || !connection.isOperator;
  write(byId("drive-arm"), `Arm: ${whatMoves(status)} will move to the target and hold it`);
  write(byId("drive-start"), armed ? `Start: ${whatMoves(status)} moves now` : "Start");
  write(byId("drive-hint"), driving ? "Keep this tab in front: without it the bench stops within half a second." : reason);
  showTarget(status, driving && connection.isOperator);
}

/** @param {any} status @param {boolean} enabled */
function showTarget(status, enabled) {
  const slider = byId("target");
  const field = byId("target-number");
  const [low, high] = status?.limits?.displacement ?? [0, 100];
  for (const input of [slider, field]) {
    input.disabled = !enabled;
    input.min = low;
    input.max = high;
  }
  write(byId("target-unit"), status?.limits?.units?.displacement ?? "mm");
  const touched = document.activeElement === slider || document.activeElement === field;
  if (status?.target_mm != null && !touched) slider.value = field.value = String(Math.round(2 * status.target_mm) / 2);
  write(byId("drive-run"), status?.target_mm == null ? "Arm a drive to set a target." : `Target ${number(status.target_mm, "mm")} mm. Stop ends the drive.`);
}
