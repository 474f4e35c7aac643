// Requests to the daemon, and its events. The state and the access token are those of `estop.js`.

const ANSWER_MS = 6000;
// A play is compiled as a whole before its answer.
const COMPILE_MS = 60000;
// How long an answer may take that waits for the daemon's disk.
export const DISK_MS = 60000;
// Events that one task takes, at most: E-STOP is heard between two tasks.
const EVENTS = 100;

// `known`: the status, or null if none is fresh. `last`: the last one, of any age. `poll`: requests it.
export const { headers, known, last, poll } = globalThis.meissner;

// An error of the daemon (`code` as in the API reference), or of the connection (`unreachable`, `slow`, `stopped`).
export class Problem extends Error {
  constructor(code, detail) {
    super(detail);
    this.code = code;
  }
}

// Aborts every request of the modules. Any emergency stop, even of this window, does so, to get a free connection.
let pending = new AbortController();
const windows = new BroadcastChannel("estop");
windows.onmessage = () => {
  pending.abort(new Problem("stopped", "An emergency stop ended this request."));
  pending = new AbortController();
};

// Waits for a part of a request, and explains a failure.
async function part(promise, signal) {
  try {
    return await promise;
  } catch {
    if (signal.reason instanceof Problem) throw signal.reason;
    if (signal.reason?.name === "TimeoutError") throw new Problem("slow", "The daemon took too long to answer.");
    throw new Problem("unreachable", "The daemon does not answer.");
  }
}

async function request(method, path, body, signal, kind = "application/json") {
  const type = body === undefined ? {} : { "content-type": kind };
  const init = { method, headers: { ...headers(), ...type }, signal, cache: "no-store", body };
  const response = await part(fetch(path, init), signal);
  if (response.ok) return response;
  const problem = await response.json().catch(() => ({}));
  throw new Problem(problem.code ?? String(response.status), problem.detail ?? response.statusText);
}

async function answer(method, path, body, ms, kind) {
  const signal = AbortSignal.any([pending.signal, AbortSignal.timeout(ms)]);
  const response = await request(method, path, body, signal, kind);
  return part(response.json(), signal);
}

// JSON has no NaN: it would become null.
function number(key, value) {
  if (Number.isNaN(value)) throw new Problem("bad-request", `\`${key}\` is not a number: enter one.`);
  return value;
}

// Requests under way that change something, by what they ask: one that asks the same gets the same answer, and is not sent.
const changes = new Map();

// The JSON answer of a request. `ms`: how long it may take.
export async function call(method, path, body, ms = ANSWER_MS) {
  const text = body === undefined ? undefined : JSON.stringify(body, number);
  if (method === "GET") return answer(method, path, text, ms);
  const key = `${method} ${path} ${text}`;
  if (!changes.has(key)) changes.set(key, answer(method, path, text, ms).finally(() => changes.delete(key)));
  return changes.get(key);
}

// The text of an answer.
export async function text(path, ms = ANSWER_MS) {
  const signal = AbortSignal.any([pending.signal, AbortSignal.timeout(ms)]);
  const response = await request("GET", path, undefined, signal);
  return part(response.text(), signal);
}

// Orders a play, in the session that the page shows: the daemon refuses it if another one runs.
export async function order(path, body) {
  if (!known()) await poll();
  const status = known();
  if (!status) throw new Problem("not-known", "Nothing was ordered: the state is not known.");
  const session = status.session?.id;
  const answer = await call("POST", path, session ? { ...body, session } : body, COMPILE_MS);
  await poll();
  return answer;
}

// Stores a TOML file.
export function put(path, text) {
  return answer("PUT", path, text, DISK_MS, "application/toml");
}

// Calls `each` for every event, and `linked(true)` or `linked(false, problem)` when the stream begins or ends. It connects again by
// itself. A hidden window does not listen, which frees its connection.
export function listen(each, linked) {
  let stop = null;
  let pause = 250;
  const run = async () => {
    const control = new AbortController();
    stop = () => control.abort();
    const stopped = pending.signal;
    let problem = new Problem("unreachable", "The daemon does not answer.");
    try {
      const response = await request("GET", "/v1/events", undefined, AbortSignal.any([control.signal, stopped]));
      linked(true);
      pause = 250;
      await read(response.body, each);
    } catch (error) {
      if (error instanceof Problem) problem = error;
    }
    stop = null;
    if (document.hidden) return;
    if (!stopped.aborted) {
      linked(false, problem);
      if (problem.code === "unauthorized") return;
    }
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
  let taken = 0;
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value;
    let end;
    while ((end = text.indexOf("\n\n")) >= 0) {
      const line = text.slice(0, end).split("\n").find((part) => part.startsWith("data: "));
      text = text.slice(end + 2);
      if (line) each(JSON.parse(line.slice(6)));
      // Many may come at once.
      if (++taken % EVENTS === 0) await new Promise((done) => setTimeout(done));
    }
  }
}
