/** Short ways to the elements of the page. */

/** @param {string} id @returns {any} */
export const byId = (id) => document.getElementById(id);

/**
 * Make an element; attributes with a function as value are event listeners.
 * @param {string} tag
 * @param {Record<string, any>} [attributes]
 * @param {...(Node|string|number|null)} children
 * @returns {any}
 */
export function element(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") node.addEventListener(name, value);
    else if (value === true) node.setAttribute(name, "");
    else if (value !== false && value != null) node.setAttribute(name, String(value));
  }
  node.append(...children.filter((child) => child != null).map((child) => (child instanceof Node ? child : String(child))));
  return node;
}

/** Write text only where it differs: a live region speaks on every write. @param {Node} node @param {string} text */
export function write(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/**
 * Replace the choices of a select and keep what was chosen.
 * @param {HTMLSelectElement} select
 * @param {{value: string, label: string}[]} choices
 * @param {string} [none] text of the choice for none
 */
export function fill(select, choices, none) {
  const all = none && (choices.length === 0 || select.dataset.optional) ? [{ value: "", label: none }, ...choices] : choices;
  const state = JSON.stringify(all);
  if (select.dataset.state === state) return;
  select.dataset.state = state;
  const chosen = select.value;
  select.replaceChildren(...all.map(({ value, label }) => element("option", { value }, label)));
  if (all.some(({ value }) => value === chosen)) select.value = chosen;
}

/** The choices of a list of the project. @param {{name: string, path: string}[]} [items] */
export const choices = (items) => (items ?? []).map(({ name, path }) => ({ value: path, label: name }));
