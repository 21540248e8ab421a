// Talking with the server: JSON calls, pictures by address, events of runs.

/** What the server refuses; `current` is the state that a change did not fit. */
export class Refusal extends Error {
  constructor(message, status, current) {
    super(message);
    this.status = status;
    this.current = current;
  }
}

const STOPPED =
  "the page's server does not answer: start `georef serve` again; nothing here is lost meanwhile";
const ANEW =
  "`georef serve` was started anew: open the address that it printed in another tab, then go on " +
  "here; nothing is lost";

async function answered(response) {
  let content;
  try {
    content = await response.json();
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Refusal(`the page's server gave no answer (${response.status})`, response.status);
  }
  if (response.status === 403) throw new Refusal(ANEW, 403);
  if (!response.ok) throw new Refusal(content.error, response.status, content.current);
  return content;
}

async function reached(address, options) {
  try {
    return await fetch(address, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Refusal(STOPPED, 0);
  }
}

export async function get(address) {
  return answered(await reached(address));
}

export async function post(address, content = {}, signal = undefined) {
  return answered(
    await reached(address, {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify(content),
      signal,
    }),
  );
}

/** Call of a service. */
export const ask = (service, name, content, signal) =>
  post(`/api/${service}/${name}`, content, signal);

/** Asks where only the last question counts: an earlier one that still waits is given up. */
export function latest(service, name) {
  let waiting = null;
  return async (content) => {
    waiting?.abort();
    const mine = (waiting = new AbortController());
    try {
      return await ask(service, name, content, mine.signal);
    } catch (error) {
      if (error.name === "AbortError") return null;
      throw error;
    } finally {
      if (waiting === mine) waiting = null;
    }
  };
}

/** Address of a picture. */
export function picture(service, name, content) {
  return `/pictures/${service}/${name}?${new URLSearchParams(content)}`;
}
