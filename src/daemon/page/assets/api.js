// Requests to the daemon, its events, and the access token that goes with both.

const KEY = "meissner-token";
const ANSWER_MS = 6000;

// The access token, for as long as the window is open. A link never holds it.
export const token = {
  get: () => sessionStorage.getItem(KEY),
  set: (value) => sessionStorage.setItem(KEY, value),
};

// An error of the daemon (`code` as in the API reference), or of the way to it (`unreachable`).
export class Problem extends Error {
  constructor(code, detail) {
    super(detail);
    this.code = code;
  }
}

export function headers() {
  const value = token.get();
  return value ? { authorization: `Bearer ${value}` } : {};
}

async function request(method, path, body, signal, kind = "application/json") {
  const type = body === undefined ? {} : { "content-type": kind };
  const init = { method, headers: { ...headers(), ...type }, signal, cache: "no-store", body };
  let response;
  try {
    response = await fetch(path, init);
  } catch (error) {
    throw new Problem("unreachable", "The daemon does not answer.");
  }
  if (response.ok) return response;
  const problem = await response.json().catch(() => ({}));
  throw new Problem(problem.code ?? String(response.status), problem.detail ?? response.statusText);
}

// The JSON answer of a request. `ms`: how long it may take.
export async function call(method, path, body, ms = ANSWER_MS) {
  const response = await request(method, path, body === undefined ? undefined : JSON.stringify(body), AbortSignal.timeout(ms));
  return response.json();
}

// Stores a TOML file.
export async function put(path, text) {
  return (await request("PUT", path, text, AbortSignal.timeout(ANSWER_MS), "application/toml")).json();
}

// Calls `each` for every event, and `linked(true)` or `linked(false, problem)` when the stream begins or ends. It connects again by itself.
// A hidden window does not listen: a browser has six connections to a host for all its windows, and an emergency stop needs one.
export function listen(each, linked) {
  let stop = null;
  let pause = 250;
  const run = async () => {
    const control = new AbortController();
    stop = () => control.abort();
    let problem = new Problem("unreachable", "The daemon does not answer.");
    try {
      const response = await request("GET", "/v1/events", undefined, control.signal);
      linked(true);
      pause = 250;
      await read(response.body, each);
    } catch (error) {
      if (error instanceof Problem) problem = error;
    }
    stop = null;
    if (document.hidden) return;
    linked(false, problem);
    if (problem.code === "unauthorized") return;
    setTimeout(start, pause);
    pause = Math.min(2 * pause, 4000);
  };
  const start = () => {
    if (!stop && !document.hidden) run();
  };
  document.addEventListener("visibilitychange", () => (document.hidden ? stop?.() : start()));
  start();
  return start;
}

async function read(body, each) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value;
    let end;
    while ((end = text.indexOf("\n\n")) >= 0) {
      const line = text.slice(0, end).split("\n").find((part) => part.startsWith("data: "));
      text = text.slice(end + 2);
      if (line) each(JSON.parse(line.slice(6)));
    }
  }
}
