/** State, operator and their buttons, always visible. */
import { byId, write } from "./dom.js";

const WORDS = {
  offline: ["–", "Not connected to hitchid"],
  disconnected: ["○", "No source connected"],
  idle: ["●", "Idle: nothing moves"],
  armed: ["▲", "Armed: ready to start"],
  running: ["▶", "Running"],
  stopped: ["■", "Stopped"],
};

/** @param {import("./connection.js").Connection} connection @param {import("./project.js").Project} project */
export function bindHeader(connection, project) {
  const update = () => showHeader(connection);
  connection.addEventListener("change", update);
  project.addEventListener("change", () => write(byId("folder"), project.content.folder ?? ""));
  byId("claim").addEventListener("click", () => connection.order(connection.isOperator ? "release" : "claim"));
  update();
}

/** @param {import("./connection.js").Connection} connection */
function showHeader(connection) {
  const { status, online, isOperator } = connection;
  const state = online && status ? status.state : "offline";
  const [sign, plain] = WORDS[state] ?? ["?", state];
  const word = state === "running" ? `Running: ${whatMoves(status)} moves` : plain;
  byId("state").dataset.state = state;
  write(byId("state-sign"), sign);
  write(byId("state-word"), word);
  write(byId("state-reason"), online ? (status?.reason ?? "") : "");
  byId("reset").hidden = state !== "stopped";
  byId("reset").disabled = !isOperator;
  write(byId("operator"), online ? operatorText(connection) : "");
  byId("claim").hidden = !online || (!isOperator && status?.operator != null);
  write(byId("claim"), isOperator ? "Hand over" : "Become operator");
  document.title = `${word} – hitchid`;
}

/** @param {import("./connection.js").Connection} connection */
function operatorText({ status, isOperator }) {
  const viewers = status?.viewers ?? 0;
  const also = viewers === 1 ? "1 viewer" : `${viewers} viewers`;
  if (isOperator) return viewers ? `You are the operator, ${also}` : "You are the operator";
  return status?.operator ? "You are a viewer; another page operates" : "You are a viewer; nobody operates";
}

/** Why this page cannot order a motion now, or "". @param {import("./connection.js").Connection} connection */
export function whyNot({ status, online, isOperator }) {
  if (!online || !status) return "There is no connection to hitchid.";
  if (!isOperator) return status.operator ? "You are a viewer: only the operator arms." : "Nobody operates: press Become operator, above.";
  if (status.state === "stopped") return "Stopped: press Reset, above, first.";
  if (!status.source) return "Connect a source under Bench first.";
  if (!status.source.can_move) return `The source “${status.source.label}” moves nothing: connect one that does, under Bench.`;
  if (status.state === "running") return "A run is in progress.";
  return "";
}

/** Name of what moves. @param {any} status */
export const whatMoves = (status) => (status?.source?.virtual ? "the virtual hitch" : "the hitch");
