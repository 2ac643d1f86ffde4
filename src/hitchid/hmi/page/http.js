/** Requests to the server; an error is a sentence that says what to do. */

const NO_ANSWER = "hitchid does not answer. Check that the command hitchid hmi is still running.";

/**
 * @param {string} path
 * @param {RequestInit} [options]
 * @returns {Promise<Response>}
 */
export async function request(path, options = {}) {
  let response;
  try {
    response = await fetch(path, { credentials: "same-origin", ...options });
  } catch {
    throw new Error(NO_ANSWER);
  }
  if (response.ok) return response;
  const answer = await response.json().catch(() => ({}));
  const error = new Error(answer.error ?? `hitchid refused ${path} (status ${response.status}). Look at the terminal of hitchid hmi.`);
  throw Object.assign(error, { status: response.status });
}

/** @param {string} path @param {any} body @returns {Promise<any>} */
export async function post(path, body) {
  const response = await request(path, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
  });
  return response.status === 204 ? null : response.json();
}

/** @param {string} path @returns {Promise<any>} */
export const get = async (path) => (await request(path)).json();
