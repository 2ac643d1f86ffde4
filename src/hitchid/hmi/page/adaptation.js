/** Adaptation of the model beside the measurement: the switch, what is in use, what happened, the way back. */
import { byId, element, write } from "./dom.js";
import { change, freshName } from "./words.js";

const OFF = { state: "off", reason: "", log: "", strokes: {}, directions: {}, events: [] };
const KINDS = {
  promoted: "Promoted",
  "rolled back": "Rolled back",
  "change detected": "Change detected",
  "at limit": "Limit reached",
  fault: "Fault",
  refused: "Stroke not learned from",
};
const WITH_CHANGES = ["promoted", "rolled back", "at limit"];

/** @param {import("./connection.js").Connection} connection @param {import("./project.js").Project} project */
export function bindAdaptation(connection, project) {
  const view = new AdaptationView(connection, project);
  connection.addEventListener("adaptation", ({ detail }) => view.take(detail));
  connection.addEventListener("change", () => view.show());
  project.addEventListener("change", () => view.proposeName());
  byId("adapt").addEventListener("change", ({ target }) => view.switch(target.checked));
  byId("adapt-back").addEventListener("click", () => view.rollBack());
  byId("adapt-keep").addEventListener("click", () => view.closeQuestion());
  byId("save-name").addEventListener("input", ({ target }) => (target.dataset.changed = "yes"));
  byId("save-form").addEventListener("submit", (event) => {
    event.preventDefault();
    view.save();
  });
  view.show();
}

class AdaptationView {
  #adaptation = OFF;
  #asked = "";
  #isSwitching = false;

  /** @param {import("./connection.js").Connection} connection @param {import("./project.js").Project} project */
  constructor(connection, project) {
    this.connection = connection;
    this.project = project;
  }

  /** @param {any} adaptation */
  take(adaptation) {
    this.#adaptation = adaptation;
    byId("adapt-events").replaceChildren(...adaptation.events.map((event) => this.#event(event)));
    write(byId("adapt-strokes"), this.#strokesText());
    this.#listDirections();
    this.proposeName();
    this.show();
  }

  /** What depends on who operates, and on the model. */
  show() {
    const { status, isOperator } = this.connection;
    const { state, directions } = this.#adaptation;
    const isOn = state === "on";
    byId("adapt").disabled = !isOperator || !status?.model;
    if (!this.#isSwitching) byId("adapt").checked = state !== "off";
    write(byId("adapt-note"), this.#noteText(Boolean(status?.model)));
    byId("adapt-body").hidden = !isOn;
    for (const row of byId("adapt-changes").children) {
      const known = directions[row.dataset.direction];
      row.querySelector("button").disabled = !isOperator || !known?.can_roll_back;
    }
    if (!isOperator || !directions[this.#asked]?.can_roll_back) this.closeQuestion();
    byId("save-name").disabled = byId("save-adapted").disabled = !isOperator;
  }

  proposeName() {
    const model = this.connection.status?.model?.split("/").pop();
    const field = byId("save-name");
    if (model && !field.dataset.changed) field.value = freshName(`${model}-adapted`, this.project.content.models);
  }

  /** The switch stays where the operator put it until the answer comes. @param {boolean} on */
  async switch(on) {
    this.#isSwitching = true;
    await this.connection.order("adapt", { on });
    this.#isSwitching = false;
    this.show();
  }

  async rollBack() {
    const direction = this.#asked;
    this.closeQuestion();
    await this.connection.order("roll_back", { direction });
  }

  closeQuestion() {
    if (!this.#asked) return;
    const button = this.#rowOf(this.#asked)?.querySelector("button");
    const hadFocus = byId("adapt-confirm").contains(document.activeElement);
    byId("adapt-confirm").hidden = true;
    this.#asked = "";
    if (hadFocus) (button?.disabled === false ? button : byId("adapt")).focus();
  }

  async save() {
    const field = byId("save-name");
    const name = field.value.trim();
    if (!(await this.connection.order("save_adapted", { name }))) return;
    write(byId("save-note"), `Saved as models/${name}. Its parameters stay as they are now.`);
    field.dataset.changed = "";
  }

  /** @param {string} direction */
  #ask(direction) {
    this.#asked = direction;
    write(byId("adapt-question"), `Return ${direction} to the parameters before its last promotion, as soon as nothing moves?`);
    byId("adapt-confirm").hidden = false;
    byId("adapt-back").focus();
  }

  /** @param {string} direction @returns {HTMLElement|undefined} */
  #rowOf(direction) {
    return [...byId("adapt-changes").children].find((row) => row.dataset.direction === direction);
  }

  /** Rows stay while their directions do: a button keeps the focus. */
  #listDirections() {
    const { directions } = this.#adaptation;
    const names = Object.keys(directions);
    const body = byId("adapt-changes");
    if ([...body.children].map((row) => row.dataset.direction).join() !== names.join()) {
      body.replaceChildren(...names.map((name) => this.#row(name)));
    }
    for (const [name, { gain_percent: gain, dead_zone: deadZone }] of Object.entries(directions)) {
      const [gainCell, deadZoneCell] = this.#rowOf(name).querySelectorAll("td");
      write(gainCell, change(gain, "percent"));
      write(deadZoneCell, change(deadZone, this.#commandUnit));
    }
  }

  /** @param {string} direction */
  #row(direction) {
    const button = element("button", { type: "button", class: "quiet", "data-testid": `roll-back-${direction}`,
      "aria-label": `Roll back ${direction} …`, click: () => this.#ask(direction) }, "Roll back …");
    return element("tr", { "data-direction": direction }, element("th", { scope: "row" }, direction),
      element("td"), element("td"), element("td", {}, button));
  }

  get #commandUnit() {
    return this.connection.status?.source?.signals.find(({ group }) => group === "command")?.unit ?? "";
  }

  /** @param {boolean} hasModel */
  #noteText(hasModel) {
    const { state, reason } = this.#adaptation;
    if (!hasModel) return "Choose a model above first.";
    if (state === "starting") return "Starting: this takes some seconds. The predictions go on.";
    if (state === "on") return "On: gain and dead zone follow the machine, stroke by stroke.";
    return `${reason ? `Switched off: ${reason}. ` : ""}Off: the model is used as identified, and nothing is learned.`;
  }

  #strokesText() {
    const { strokes, log } = this.#adaptation;
    return `${strokes.learned ?? 0} strokes learned from, ${strokes.refused ?? 0} not. All events: ${log}.`;
  }

  /** @param {any} event */
  #event({ kind, direction, reason, at_s: at, gain_percent: gain, dead_zone: deadZone }) {
    const changes = WITH_CHANGES.includes(kind) ? `gain ${change(gain, "percent")}, dead zone ${change(deadZone, this.#commandUnit)}` : "";
    const text = [changes, reason].filter(Boolean).join("; ");
    return element("li", { "data-kind": kind }, element("strong", {}, KINDS[kind] ?? kind),
      ` ${[direction, `at ${at.toFixed(0)} s`].filter(Boolean).join(", ")}${text ? `: ${text}` : ""}.`);
  }
}
