/**
 * The one connection to the server: session, websocket, requests with replies, heartbeat.
 *
 * Events: `change` (state of the connection, `status` or `hello`), `frame`, `job`, `adaptation`, `project_changed`, `sources`, `problem`.
 * After a loss it connects again by itself; it never arms or starts by itself.
 */
import { get, post } from "./http.js";
import { readFrame } from "./frames.js";

const HEARTBEAT_MS = 150; // the bench stops when it hears nothing for 500 ms
const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 4000;
const LOST = "The connection to hitchid is lost: what the machine does is not known here. The bench loop stops by itself when it hears nothing of this page. Connecting again …";
const SILENT = "hitchid does not answer. Check that the command hitchid hmi is still running. Connecting again …";
const BACK = "The connection to hitchid was lost and is back. Nothing was armed or started again by itself.";
const OFFLINE = "Not sent: there is no connection to hitchid. Use the machine's own emergency stop if it moves.";

export class Connection extends EventTarget {
  /** @type {any} */ hello = null;
  /** @type {any} */ status = null;
  online = false;
  /** @type {WebSocket|null} */ #socket = null;
  #requests = 0;
  #wait = FIRST_WAIT_MS;
  /** @type {Map<number, (error: string|null) => void>} */ #replies = new Map();

  get isOperator() {
    return this.online && this.hello != null && this.status?.operator === this.hello.you;
  }

  get canMove() {
    return this.status?.state === "armed" || this.status?.state === "running";
  }

  /** Begin the session with the token of the link, then connect. */
  async open() {
    if (location.hash.startsWith("#token=")) {
      const token = location.hash.slice("#token=".length);
      history.replaceState(null, "", location.pathname);
      await post("/api/session", { token }).catch(() => null);
    }
    setInterval(() => this.#heartbeat(), HEARTBEAT_MS);
    await this.#connect();
  }

  /**
   * @param {string} type
   * @param {Record<string, any>} [fields]
   * @returns {Promise<void>} rejected with the server's sentence
   */
  send(type, fields = {}) {
    if (!this.online) return Promise.reject(new Error(OFFLINE));
    this.#requests += 1;
    const id = this.#requests;
    return new Promise((resolve, reject) => {
      this.#replies.set(id, (error) => (error ? reject(new Error(error)) : resolve()));
      this.#socket?.send(JSON.stringify({ id, type, ...fields }));
    });
  }

  /** Send and show an error as a problem. @param {string} type @param {Record<string, any>} [fields] @returns {Promise<boolean>} */
  async order(type, fields) {
    try {
      await this.send(type, fields);
      return true;
    } catch (error) {
      this.problem(error.message);
      return false;
    }
  }

  /** @param {string} text @param {string} [topic] a later message with this topic replaces it */
  problem(text, topic) {
    this.#emit("problem", { text, topic });
  }

  async #connect() {
    try {
      await get("/api/project");
    } catch (error) {
      if (error.status === 401) {
        this.problem("This page has no session. Open the link that hitchid hmi printed in the terminal; a link opens once.", "connection");
        return;
      }
      this.#later();
      return;
    }
    const socket = new WebSocket(`ws${location.protocol === "https:" ? "s" : ""}://${location.host}/ws`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => this.#receive(data);
    socket.onclose = () => this.#closed();
    this.#socket = socket;
  }

  #closed() {
    const wasOnline = this.online;
    this.online = false;
    for (const reply of this.#replies.values()) reply(OFFLINE);
    this.#replies.clear();
    if (wasOnline) {
      this.problem(LOST, "connection");
      this.#emit("change");
    }
    this.#later();
  }

  #later() {
    if (this.hello == null) this.problem(SILENT, "connection");
    setTimeout(() => this.#connect(), this.#wait);
    this.#wait = Math.min(2 * this.#wait, LONGEST_WAIT_MS);
  }

  #heartbeat() {
    if (this.isOperator && this.canMove) this.#socket?.send('{"type": "heartbeat"}');
  }

  /** @param {string|ArrayBuffer} data */
  #receive(data) {
    if (typeof data !== "string") {
      this.#emit("frame", readFrame(data));
      return;
    }
    const message = JSON.parse(data);
    if (message.type === "reply") {
      this.#replies.get(message.id)?.(message.error);
      this.#replies.delete(message.id);
    } else if (message.type === "hello") {
      this.#greeted(message);
    } else if (message.type === "sources") {
      this.hello.sources = message.sources;
      this.#emit("sources");
    } else if (message.type === "status") {
      this.status = message;
      this.#emit("change");
    } else {
      this.#emit(message.type, message);
    }
  }

  /** @param {any} hello */
  #greeted(hello) {
    const again = this.hello != null;
    this.hello = hello;
    this.online = true;
    this.#wait = FIRST_WAIT_MS;
    this.problem(again ? BACK : "", "connection");
    this.#emit("change");
    this.#emit("greeted", hello);
    this.#emit("project_changed");
  }

  /** @param {string} name @param {any} [detail] */
  #emit(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }
}
