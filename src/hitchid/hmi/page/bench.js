/** Bench: source, model beside the measurement, recording and markers. */
import { byId, choices, element, fill, write } from "./dom.js";
import { duration } from "./words.js";

const OPTION_LABELS = { rig: "Machine", speed: "Speed, times real time", log: "Log" };

/** @param {import("./connection.js").Connection} connection @param {import("./project.js").Project} project */
export function bindBench(connection, project) {
  connection.addEventListener("greeted", () => listSources(connection));
  connection.addEventListener("sources", () => listSources(connection));
  byId("source").addEventListener("change", () => showOptions(connection));
  connection.addEventListener("change", () => showBench(connection));
  project.addEventListener("change", () => {
    byId("monitor-model").dataset.optional = "yes";
    fill(byId("monitor-model"), choices(project.content.models), "no model");
    showBench(connection);
  });
  bindOrders(connection);
  showBench(connection);
}

/** @param {import("./connection.js").Connection} connection */
function bindOrders(connection) {
  byId("connect-form").addEventListener("submit", (event) => {
    event.preventDefault();
    connection.order("connect", { source: byId("source").value, options: chosenOptions(connection) });
  });
  byId("disconnect").addEventListener("click", () => connection.order("disconnect"));
  byId("monitor-form").addEventListener("submit", (event) => event.preventDefault());
  byId("monitor-model").addEventListener("change", ({ target }) => connection.order("monitor", { model: target.value || null }));
  byId("monitor-restart").addEventListener("click", () => connection.order("monitor_restart"));
  byId("record").addEventListener("click", () => connection.order("record", { on: !connection.status?.recording }));
  byId("marker-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    if (await connection.order("marker", { text: byId("marker").value || "marker" })) byId("marker").value = "";
  });
}

/** @param {import("./connection.js").Connection} connection */
const sourceOf = (connection) => connection.hello?.sources.find(({ name }) => name === byId("source").value);

/** @param {import("./connection.js").Connection} connection */
function listSources(connection) {
  fill(byId("source"), connection.hello.sources.map(({ name, label }) => ({ value: name, label })));
  showOptions(connection);
}

/** Show the options of the chosen source; what was chosen before stays. @param {import("./connection.js").Connection} connection */
function showOptions(connection) {
  const options = sourceOf(connection)?.options ?? {};
  const before = new Map([...byId("source-options").querySelectorAll("[data-option]")].map((field) => [field.dataset.option, field.value]));
  byId("source-options").replaceChildren(...Object.entries(options).map(([name, value]) => {
    const attributes = { "data-testid": `option-${name}`, "data-option": name };
    const field = Array.isArray(value)
      ? element("select", attributes, ...(value.length ? value.map((choice) => element("option", { value: choice }, choice)) : [element("option", { value: "" }, "none yet")]))
      : element("input", { ...attributes, type: typeof value === "number" ? "number" : "text", value: value ?? "" });
    const isOffered = !Array.isArray(value) || value.some((choice) => String(choice) === before.get(name));
    if (before.has(name) && isOffered) field.value = before.get(name);
    return element("label", {}, `${OPTION_LABELS[name] ?? name} `, field);
  }));
}

/** Values of the options, with the types that the server offered. @param {import("./connection.js").Connection} connection */
function chosenOptions(connection) {
  const offered = sourceOf(connection)?.options ?? {};
  const chosen = {};
  for (const field of byId("source-options").querySelectorAll("[data-option]")) {
    const name = field.dataset.option;
    const offer = offered[name];
    if (Array.isArray(offer)) chosen[name] = offer.find((choice) => String(choice) === field.value);
    else chosen[name] = typeof offer === "number" ? Number(field.value) : field.value;
  }
  return chosen;
}

/** @param {import("./connection.js").Connection} connection */
function showBench(connection) {
  const { status, online, isOperator } = connection;
  const source = status?.source;
  const busy = connection.canMove;
  byId("connect").disabled = !isOperator || Boolean(source);
  byId("disconnect").disabled = !isOperator || !source || busy;
  byId("source").disabled = Boolean(source);
  for (const field of byId("source-options").querySelectorAll("[data-option]")) field.disabled = Boolean(source);
  write(byId("source-note"), online ? sourceText(source, status) : "");
  byId("monitor-model").disabled = !isOperator || !source;
  if (document.activeElement !== byId("monitor-model")) byId("monitor-model").value = status?.model ?? "";
  byId("monitor-restart").disabled = !isOperator || !status?.model;
  showRecording(status, !isOperator || !source);
  byId("marker").disabled = byId("marker-form").querySelector("button").disabled = !isOperator || !source;
}

/** @param {any} source @param {any} status */
function sourceText(source, status) {
  if (!source) return "Connecting moves nothing.";
  const speed = source.speed && source.speed !== 1 ? `, ${source.speed} times real time` : "";
  const late = status.late_ticks ? ` ${status.late_ticks} samples came late: close other programs on this machine.` : "";
  return `Connected to ${source.label}: a sample every ${Math.round(source.step_s * 1000)} ms${speed}.`
    + (source.can_move ? " Connecting moves nothing." : " It moves nothing.") + late;
}

/** @param {any} status @param {boolean} disabled */
function showRecording(status, disabled) {
  const recording = status?.recording;
  byId("record").disabled = disabled;
  byId("record").setAttribute("aria-pressed", String(Boolean(recording)));
  write(byId("record"), recording ? "End the recording" : "Record");
  const length = recording && status.source ? ` (${duration(recording.samples * status.source.step_s)})` : "";
  write(byId("record-note"), recording ? `Recording into ${recording.file}: ${recording.samples} samples${length}.`
    : "Every sample goes into a file under recordings/.");
}
