/** Jobs of the server: started, watched and stopped; each kind is shown where it was started. */
import { Curves } from "./curves.js";
import { element, write } from "./dom.js";
import { post, request } from "./http.js";
import { duration } from "./words.js";

const LINES = 12; // as many as can be read at a glance

export class Jobs extends EventTarget {
  /** @type {Map<number, any>} */ all = new Map();

  /** @param {import("./connection.js").Connection} connection */
  constructor(connection) {
    super();
    this.connection = connection;
    connection.addEventListener("job", ({ detail }) => {
      const before = this.all.get(detail.id)?.state;
      this.all.set(detail.id, detail);
      this.dispatchEvent(new CustomEvent(detail.kind, { detail: { job: detail, ended: before === "running" && detail.state !== "running" } }));
    });
  }

  /** @param {Record<string, any>} body @returns {Promise<number|null>} its number */
  async start(body) {
    try {
      return (await post("/api/jobs", body)).id;
    } catch (error) {
      this.connection.problem(error.message);
      return null;
    }
  }

  /** @param {number} id */
  async stop(id) {
    await request(`/api/jobs/${id}`, { method: "DELETE" }).catch((error) => this.connection.problem(error.message));
  }

  /**
   * Show the newest job of a kind in a place.
   * @param {string} kind
   * @param {HTMLElement} place
   * @param {string} title
   * @param {(job: any, ended: boolean) => void} [then]
   */
  show(kind, place, title, then) {
    const view = new JobView(this, title);
    let newest = -1;
    this.addEventListener(kind, ({ detail: { job, ended } }) => {
      if (job.id < newest) return;
      newest = job.id;
      if (!place.contains(view.box)) place.replaceChildren(view.box);
      view.update(job);
      then?.(job, ended);
    });
  }
}

/** @param {any} job */
function ending({ state, out }) {
  if (state === "done") return out ? `Done: ${out}` : "Done.";
  return state === "failed" ? "Failed: the last lines say why." : "Stopped before its end.";
}

class JobView {
  #id = 0;

  /** @param {Jobs} jobs @param {string} title */
  constructor(jobs, title) {
    this.stage = element("p", { class: "stage" });
    this.bar = element("progress", { max: 1, "aria-label": `Progress: ${title}` });
    this.left = element("span", { class: "left" });
    this.stop = element("button", { type: "button", click: () => jobs.stop(this.#id) }, "Stop this computation");
    this.lines = element("pre", { tabindex: 0, "aria-label": `Last lines: ${title}` });
    this.details = element("details", {}, element("summary", {}, "Last lines"), this.lines);
    this.curves = new Curves();
    this.box = element("div", { class: "card job", "data-testid": "job-progress" }, element("h3", {}, title), this.stage,
      element("div", { class: "progress" }, this.bar, this.left), this.curves.box, this.details, this.stop);
  }

  /** @param {any} job */
  update(job) {
    this.#id = job.id;
    const running = job.state === "running";
    this.box.dataset.state = job.state;
    write(this.stage, running ? job.stage || "Starting …" : ending(job));
    this.bar.parentElement.hidden = !running;
    if (job.fraction == null) this.bar.removeAttribute("value");
    else this.bar.value = job.fraction;
    const percent = job.fraction == null ? "" : `${Math.round(100 * job.fraction)} %`;
    write(this.left, [percent, job.left_s == null ? "" : `${duration(job.left_s)} left`].filter(Boolean).join(", "));
    write(this.lines, (job.lines ?? []).slice(-LINES).join("\n"));
    this.details.hidden = !job.lines?.length;
    if (job.state === "failed") this.details.open = true;
    this.stop.hidden = !running;
    this.curves.update(job.curves ?? {});
  }
}
