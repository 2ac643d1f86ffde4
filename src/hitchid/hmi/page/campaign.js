/** Campaign: a plan, what it will move, its run, and the audit of its logs. */
import { auditTable } from "./audit.js";
import { byId, choices, element, fill, write } from "./dom.js";
import { whatMoves, whyNot } from "./header.js";
import { choose } from "./identify.js";
import { duration, freshName, number, today } from "./words.js";

const BETWEEN_TESTS_S = 8; // positioning and settling before a test, about
const FIELDS = [
  { name: "ramps", label: "Ramps each direction", value: 2, min: 0, max: 20 },
  { name: "ramp_s", label: "Length of a ramp, s", value: 15, min: 2, max: 120 },
  { name: "tests", label: "PRBS tests each direction", value: 4, min: 0, max: 100 },
  { name: "test_s", label: "Length of a test, s", value: 10, min: 2, max: 600 },
  { name: "cycles", label: "Cycles of both", value: 0, min: 0, max: 50 },
  { name: "cycle_s", label: "Length of a cycle, s", value: 60, min: 10, max: 600 },
  { name: "seed", label: "Seed of the commands", value: 0, min: 0, max: 2147483647 },
];

/**
 * @param {import("./connection.js").Connection} connection
 * @param {import("./project.js").Project} project
 * @param {import("./jobs.js").Jobs} jobs
 */
export function bindCampaign(connection, project, jobs) {
  makeFields();
  const update = () => showPlan(connection);
  connection.addEventListener("change", update);
  byId("plan-form").addEventListener("input", update);
  project.addEventListener("change", () => {
    if (!byId("plan-name").dataset.changed) byId("plan-name").value = freshName(`campaign-${today()}`, project.content.campaigns);
    fill(byId("plan-file"), choices(project.content.uploads), "no file yet");
    fill(byId("design-model"), choices(project.content.models), "no model yet");
    fill(byId("audit-logs"), choices(project.content.campaigns), "no campaign yet");
    update();
  });
  byId("plan-name").addEventListener("input", ({ target }) => (target.dataset.changed = "yes"));
  byId("plan-form").addEventListener("submit", (event) => {
    event.preventDefault();
    connection.order("arm", { plan: plan() });
  });
  byId("start").addEventListener("click", () => connection.order("start"));
  bindDesign(project, jobs);
  bindRun(connection, jobs, project);
  bindAudit(jobs);
  update();
}

function makeFields() {
  const fields = FIELDS.map(({ name, label, ...attributes }) =>
    element("label", {}, `${label} `, element("input", { type: "number", required: true, step: 1, ...attributes, id: `plan-${name}`, "data-testid": `plan-${name}` })));
  const directions = element("select", { id: "plan-directions", "data-testid": "plan-directions" },
    element("option", { value: "lifting lowering" }, "both"), element("option", {}, "lifting"), element("option", {}, "lowering"));
  const unattended = element("label", { class: "check", id: "plan-unattended-label" },
    element("input", { type: "checkbox", id: "plan-unattended", "data-testid": "plan-unattended" }),
    " Goes on when this page is closed (virtual bench only)");
  byId("plan-campaign").append(element("label", {}, "Directions ", directions), ...fields, unattended);
}

/** The plan as the server reads it. */
function plan() {
  const name = byId("plan-name").value.trim();
  if (byId("plan-kind").value === "file") return { kind: "file", name, file: byId("plan-file").value };
  const unattended = byId("plan-unattended").checked;
  if (byId("plan-kind").value === "adaptive") {
    const goal = byId("plan-goal").value.trim() || null;
    return { kind: "adaptive", name, minutes: Number(byId("plan-minutes").value), goal, resume: byId("plan-resume").checked, unattended };
  }
  const numbers = Object.fromEntries(FIELDS.map((field) => [field.name, Number(byId(`plan-${field.name}`).value)]));
  return { kind: "campaign", name, ...numbers, directions: byId("plan-directions").value.split(" "), unattended };
}

/** Number of tests and their length. @param {any} asked @param {number} speed times real time */
export function extent(asked, speed) {
  const ways = asked.directions.length;
  const tests = ways * (asked.ramps + asked.tests) + asked.cycles;
  const motion = ways * (asked.ramps * asked.ramp_s + asked.tests * asked.test_s) + asked.cycles * asked.cycle_s;
  return { tests, seconds: (motion + tests * BETWEEN_TESTS_S) / speed };
}

/** What will move, in words. @param {any} asked @param {any} status */
function announcement(asked, status) {
  const what = whatMoves(status);
  if (asked.kind === "file") return `Arm: ${what} will move as ${asked.file.split("/").pop() || "the file"} says`;
  if (asked.kind === "adaptive") return `Arm: ${what} will move up and down, carefully first, then test after test, ${asked.minutes} min at most`;
  const { tests, seconds } = extent(asked, status?.source?.speed ?? 1);
  return `Arm: ${what} will move up and down, ${tests} ${tests === 1 ? "test" : "tests"}, about ${duration(seconds)}`;
}

/** @param {import("./connection.js").Connection} connection */
function showPlan(connection) {
  const { status } = connection;
  const asked = plan();
  const isFile = asked.kind === "file";
  const isAdaptive = asked.kind === "adaptive";
  byId("plan-campaign").hidden = isFile || status?.state === "running"; // room for the progress
  byId("plan-adaptive").hidden = !isAdaptive || status?.state === "running";
  byId("plan-own").hidden = !isFile;
  for (const label of byId("plan-campaign").children) label.hidden = isAdaptive && label.id !== "plan-unattended-label";
  for (const field of byId("plan-campaign").querySelectorAll("input, select")) field.disabled = isFile || isAdaptive;
  for (const field of byId("plan-adaptive").querySelectorAll("input")) field.disabled = !isAdaptive;
  byId("plan-unattended").disabled = isFile || !status?.source?.virtual;
  const reason = whyNot(connection);
  const armedHere = status?.state === "armed" && status.run?.kind !== "drive";
  const nothing = isFile ? !asked.file : !isAdaptive && extent(asked, 1).tests === 0;
  byId("arm").disabled = Boolean(reason) || status?.state === "armed" || nothing;
  byId("start").disabled = !armedHere || !connection.isOperator;
  write(byId("arm"), announcement(asked, status));
  write(byId("start"), armedHere ? `Start: ${whatMoves(status)} moves now` : "Start");
  write(byId("plan-limits"), limitsText(status?.limits));
  write(byId("plan-hint"), reason || (armedHere ? "Armed. Keep this tab in front: without it the bench stops within half a second." : nothing ? (isFile ? "Upload a file of commands or propose one." : "Ask for one ramp, test or cycle at least.") : ""));
}

/** @param {any} limits */
export function limitsText(limits) {
  if (!limits) return "";
  const { command, displacement } = limits.units;
  const [low, high] = limits.displacement;
  return `Limits: lifting ${number(limits.lifting_command, command)} ${command}, lowering ${number(limits.lowering_command, command)} ${command}, `
    + `displacement ${low} to ${high} ${displacement}.`;
}

/** @param {import("./project.js").Project} project @param {import("./jobs.js").Jobs} jobs */
function bindDesign(project, jobs) {
  byId("design-start").addEventListener("click", () => {
    const direction = byId("design-direction").value;
    const name = freshName(`next-${direction}`, project.content.uploads?.map(({ name }) => ({ name: name.replace(/\.csv$/, "") })));
    jobs.start({ kind: "design", model: byId("design-model").value, direction, name });
  });
  jobs.show("design", byId("design-job"), "Proposal of the next test");
}

/** Progress of a run; at its end the audit of its logs. */
function bindRun(connection, jobs, project) {
  let last = null;
  connection.addEventListener("change", () => {
    const { status } = connection;
    const run = connection.online && status?.run?.kind !== "drive" ? status?.run : null;
    byId("run-progress").hidden = !run;
    if (run) showRun(run, status);
    if (last && status?.state !== "running" && connection.online) {
      if (connection.isOperator) jobs.start({ kind: "inspect", logs: last });
      byId("plan-name").dataset.changed = "";
      for (const id of ["audit-logs", "identify-logs", "validate-logs"]) choose(byId(id), last, project);
      last = null;
    }
    if (run && status.state === "running") last = run.folder;
  });
}

const PHASES = { rest: "measuring noise and drift at rest", ramp: "careful start", planning: "fitting the model, choosing the next test", positioning: "moving to the start", settling: "waiting for rest", test: "test runs" };

/** @param {any} run @param {any} status */
function showRun(run, status) {
  write(byId("run-title"), status.state === "armed" ? `Armed: ${run.name}` : `Run: ${run.name}`);
  byId("run-bar").value = run.fraction ?? 0;
  const count = run.kind === "adaptive" ? "" : ` ${run.number} of ${run.total},`;
  const test = run.test ? `Test${count} ${run.test}` : "";
  write(byId("run-why"), run.why ? `Why: ${run.why}.` : "");
  const step = [test, PHASES[run.phase] ?? run.phase].filter(Boolean).join(": ");
  write(byId("run-text"), [step, run.left_s == null ? "" : `${duration(run.left_s)} left`].filter(Boolean).join(". "));
}

/** @param {import("./jobs.js").Jobs} jobs */
function bindAudit(jobs) {
  byId("audit-form").addEventListener("submit", (event) => {
    event.preventDefault();
    if (byId("audit-logs").value) jobs.start({ kind: "inspect", logs: byId("audit-logs").value });
  });
  jobs.show("inspect", byId("audit-job"), "Audit", (job) => {
    byId("audit-job").hidden = job.state === "done";
    byId("audit-result").replaceChildren(...(job.result ? [element("h3", {}, job.logs ?? titleOf(job.command)), ...auditTable(job.result)] : []));
  });
}

/** The folder in a command as `hitchid inspect campaigns/a --json`. @param {string} command */
const titleOf = (command) => command?.split(" ").find((word) => word.includes("/") && !word.startsWith("-")) ?? "";
