/** The audit of logs, as `hitchid inspect --json` prints it, as a table. */
import { element } from "./dom.js";
import { duration } from "./words.js";

const LEVELS = { error: ["✕", "Error", "bad"], warning: ["!", "Warning", "caution"], note: ["i", "Note", ""] };
const PLACES = 3; // the command line lists all

/** @param {any} result @returns {Node[]} */
export function auditTable(result) {
  const { records = [], findings = [], faults = [], left_out: leftOut = [], notices = [] } = result;
  const seconds = records.reduce((sum, record) => sum + record.duration_s, 0);
  const summary = element("p", {}, `${records.length} logs, ${duration(seconds)} in all. `,
    findings.length ? `${findings.length} findings:` : "Nothing was found that would spoil a model.");
  const more = [...faults, ...leftOut, ...notices].map((item) => element("li", {}, sentence(item)));
  return [summary, ...(findings.length ? [table(findings)] : []), ...(more.length ? [element("ul", { class: "notices" }, ...more)] : [])];
}

/** @param {any} item a sentence, or an object of them */
const sentence = (item) => (typeof item === "string" ? item : Object.values(item).join(": "));

/** @param {any[]} findings */
function table(findings) {
  const head = ["Level", "Check", "What was found", "What to do", "Where"].map((text) => element("th", { scope: "col" }, text));
  const rows = findings.map((finding) => {
    const [sign, word, kind] = LEVELS[finding.level] ?? ["i", finding.level, ""];
    return element("tr", {},
      element("td", { class: `level ${kind}` }, element("span", { class: "sign", "aria-hidden": "true" }, sign), ` ${word}`),
      element("th", { scope: "row" }, finding.check),
      element("td", { "data-label": "Found" }, finding.what),
      element("td", { "data-label": "To do" }, finding.advice),
      element("td", { "data-label": "Where" }, where(finding)));
  });
  return element("table", { class: "findings" }, element("caption", { class: "unseen" }, "Findings of the audit"),
    element("thead", {}, element("tr", {}, ...head)), element("tbody", {}, ...rows));
}

/** @param {any} finding */
function where({ places = [], records = [], signal }) {
  const spans = places.slice(0, PLACES).map(({ record, start_s, stop_s }) => `${record} ${start_s.toFixed(1)}–${stop_s.toFixed(1)} s`);
  const names = spans.length ? spans : records.slice(0, PLACES);
  const rest = (spans.length ? places : records).length - names.length;
  return [names.join(", ") || (signal ?? "").replaceAll("_", " "), rest > 0 ? `and ${rest} more` : ""].filter(Boolean).join(" ");
}
