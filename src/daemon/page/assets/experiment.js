// A two-interval forced choice with two patterns: each trial plays both, and the participant says in which interval the pattern was that
// is asked for.
//
// A trial is a sequence of the running session with the labels `first` and `second`. Its answer is taken when the daemon has reported
// the end of the sequence. Whatever comes between stops the pins and pauses the experiment: Escape, an emergency stop, a lost
// connection, another view, a hidden window. The trial without an answer is then played again. The window keeps the experiment, so it
// goes on after a reload.
//
// Invariant: a trial is counted when the daemon has its answer.

import { call, known, orderIn, poll } from "./api.js";
import { isForeign } from "./array.js";
import { order, wilson } from "./choice.js";
import { $, built, element, refuse, restored, say, speak, write } from "./control.js";
import { optional, right } from "./number.js";
import { part } from "./views.js";
import { plain } from "./words.js";

const KEPT = "meissner-experiment";
// The daemon holds the request for the end of a play for so long, s.
const HELD_S = 20;
// Codes of requests of which it is not known whether the daemon has got them.
const LOST = ["unreachable", "slow", "stopped"];
const INTERVALS = ["first", "second"];
const FIELDS = ["trials", "choice-seed", "stimulus-s", "between-ms", "pause-s"];
const NAMES = { ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓", " ": "Space" };

// What is kept: the settings, the session, `right`, for each answer whether it was right, and `unsent`, an answer that the daemon may not
// have: `{ play, body }`. Null: no experiment.
let kept = restored(KEPT);
// The trial that runs: `stop` ends it. Null: none, so the experiment is paused, or over.
let running = null;
// Takes an answer, `first` or `second`, while one is awaited.
let take = null;
let why = kept ? "The page was loaded again." : "";
// How long the patterns last that can be chosen, s; null: without end.
let durations = new Map();
// The fields in which a pattern stood already.
const offered = new Set();

function keep(what) {
  kept = what;
  if (kept) sessionStorage.setItem(KEPT, JSON.stringify(kept));
  else sessionStorage.removeItem(KEPT);
}

const isOver = () => kept.right.length >= kept.trials;

// Why no trial can begin now; empty: one can. `session`: the session that it must belong to, or nothing.
function hindrance(session) {
  const status = known();
  if (!status) return "The state is not known.";
  if (!status.session) return "No session runs: start one.";
  if (session && status.session.id !== session) return "Another session runs.";
  if (status.state !== "armed") return "The motors are not armed: press Arm.";
  return status.play || status.queued.length ? "A play runs or waits." : "";
}

// Whether the session that the experiment belongs to is over.
const isSessionOver = () => Boolean(known()) && known().session?.id !== kept.session;

const key = (interval) => kept[`${interval}_key`];
const shown = (name) => NAMES[name] ?? name;

function show() {
  // The drawing of the pins would tell the answer.
  document.documentElement.toggleAttribute("data-trial", running !== null);
  $("choice-form").hidden = kept !== null;
  $("choice-run").hidden = kept === null;
  if (!kept) {
    const text = hindrance();
    $("choice-start").disabled = text !== "";
    write($("choice-note"), text);
    return;
  }
  const [done, over] = [kept.right.length, isOver() || (!running && isSessionOver())];
  $("choice-progress").max = kept.trials;
  $("choice-progress").value = done;
  write($("choice-count"), `${done} of ${kept.trials} answers`);
  for (const interval of INTERVALS) {
    $(`answer-${interval}`).hidden = !running;
    $(`answer-${interval}`).disabled = !take;
    write($(`answer-${interval}`), `${interval === "first" ? "First" : "Second"} (${shown(key(interval))})`);
  }
  $("choice-stop").hidden = !running;
  $("choice-go").hidden = Boolean(running) || over;
  $("choice-go").disabled = !running && hindrance(kept.session) !== "";
  $("choice-new").hidden = Boolean(running);
  if (!running) write($("choice-prompt"), paused(over));
  write($("choice-result"), running ? "" : result());
}

function paused(over) {
  if (isOver()) return "All trials are answered. Thank you.";
  if (over) return `The experiment has ended: its session is over. ${why}`;
  return `Paused. ${why} ${hindrance(kept.session)}`;
}

function result() {
  const all = kept.right.length;
  if (!all) return "No trial was answered.";
  const right = kept.right.filter(Boolean).length;
  const percent = (share) => (100 * share).toFixed(1);
  const [low, high] = wilson(right, all);
  return `${right} of ${all} answers right: ${percent(right / all)} %, 95 % interval ${percent(low)} to ${percent(high)} % (Wilson). Chance: 50 %.`;
}

// A promise that resolves as `run(resolve)` says, or fails with the reason when the trial is stopped.
function until(signal, run) {
  return new Promise((resolve, reject) => {
    signal.throwIfAborted();
    signal.addEventListener("abort", () => reject(signal.reason), { once: true });
    run(resolve);
  });
}

function prompt(text) {
  write($("choice-prompt"), text);
  speak(text, "trial");
  show();
}

// Plays the next trial, and returns the play's id when it has ended as a whole.
async function stimulate(signal, trial) {
  // `seconds`: null for one run of each.
  const { asked, other, seconds, between_ms: gap, session } = kept;
  const [first, second] = order(kept.trials, kept.seed)[trial - 1] ? [asked, other] : [other, asked];
  const length = seconds === null ? {} : { seconds };
  const items = [{ pattern: first, ...length }, { pattern: second, ...length, gap_ms: gap }];
  const orNot = (promise) => Promise.race([promise, until(signal, () => {})]);
  const ordered = orderIn(session, "/v1/play", { name: `trial-${trial}`, trial, labels: { first, second }, items });
  let receipt;
  try {
    const { id } = await orNot(ordered);
    do receipt = await orNot(call("GET", `/v1/plays/${id}?wait=${HELD_S}`, undefined, 1000 * HELD_S + 10000));
    while (["queued", "running"].includes(receipt.state));
  } catch (error) {
    // The trial may play on, or begin later. If the daemon has refused it, there is nothing to stop.
    if (!error.code || LOST.includes(error.code)) for (const since of [null, ordered]) Promise.resolve(since).then(() => call("POST", "/v1/stop")).catch(() => {});
    throw error;
  }
  if (receipt.state !== "done") throw new Error(`The trial was cut (${receipt.cause}).`);
  return { play: receipt.id, right: first === asked ? "first" : "second" };
}

// Sends the answer that is not sent yet, and counts it.
async function send() {
  const { play, body } = kept.unsent;
  try {
    await call("POST", `/v1/plays/${play}/answer`, body);
  } catch (error) {
    if (error.code !== "exists") {
      // Other errors pass: “Continue” sends it again.
      if (["not-found", "session-running", "bad-request"].includes(error.code)) keep({ ...kept, unsent: null });
      throw error;
    }
    // It came before, and only the daemon's reply was lost.
  }
  keep({ ...kept, unsent: null, right: [...kept.right, body.correct] });
  document.dispatchEvent(new Event("answered"));
}

async function runTrial(signal) {
  const trial = kept.right.length + 1;
  prompt(`Trial ${trial} of ${kept.trials}.`);
  await until(signal, (resolve) => setTimeout(resolve, 1000 * kept.pause_s));
  if (!known()) await poll();
  const text = hindrance(kept.session);
  if (text) throw new Error(text);
  prompt("Feel both intervals.");
  const { play, right } = await stimulate(signal, trial);
  const begin = performance.now();
  const asks = until(signal, (resolve) => (take = (response, at) => resolve({ response, rt_ms: Math.max(0, at - begin) })));
  prompt(`Which interval had ${kept.asked}? ${shown(key("first"))} first, ${shown(key("second"))} second.`);
  const answer = await asks.finally(() => (take = null));
  keep({ ...kept, unsent: { play, body: { ...answer, correct: answer.response === right, factors: { asked: kept.asked } } } });
  await send();
}

async function run() {
  // A second click on “Continue” would count an answer that is not sent yet twice, and play two trials at once.
  if (running) return;
  const mine = (running = new AbortController());
  why = "";
  try {
    if (kept.unsent) {
      prompt("Sending the last answer …");
      await send();
    }
    while (!isOver()) await runTrial(mine.signal);
    speak(result(), "trial");
  } catch (error) {
    why = plain(error);
    speak(`Paused. ${why}`, "trial");
  }
  running = null;
  show();
}

// Pauses the experiment.
const halt = (text) => running?.abort(new Error(text));

async function start() {
  if (kept || !right(...FIELDS)) return;
  const [asked, other] = [$("asked").value, $("other").value];
  const keys = INTERVALS.map((interval) => $(`key-${interval}`).value);
  const endless = optional("stimulus-s") === undefined ? [asked, other].find((name) => durations.get(name) === null) : undefined;
  const wrong = !asked || asked === other ? "Choose two patterns that differ." : endless ? `${endless} has no end: enter the seconds of each pattern.` : keys[0] === keys[1] ? "Choose two keys that differ." : hindrance();
  if (wrong) return refuse($("choice-start"), new Error(wrong));
  const [trials, seed, seconds, between, pause] = FIELDS.map(optional);
  say($("choice-start"), "");
  keep({ session: known().session.id, asked, other, trials, seed, seconds: seconds ?? null, between_ms: between, pause_s: pause, first_key: keys[0], second_key: keys[1], right: [], unsent: null });
  $("choice-title").focus();
  run();
}

async function load() {
  const { patterns } = await call("GET", "/v1/patterns");
  const fitting = patterns.filter((pattern) => !isForeign(pattern) && (pattern.drives_moving || pattern.motions));
  durations = new Map(fitting.map((pattern) => [pattern.name, pattern.duration_s]));
  const names = [...durations.keys()];
  for (const [i, id] of ["asked", "other"].entries()) {
    const options = await built(names, (name) => element("option", name));
    const before = $(id).value;
    $(id).replaceChildren(...options);
    // A pattern that was removed is not replaced by another one unseen: the person chooses again.
    $(id).value = offered.has(id) ? before : (names[i] ?? "");
    if ($(id).value) offered.add(id);
  }
  $("choice-none").hidden = names.length > 1;
}

// Keys of a run: before all others, so that no button has them.
function press(event) {
  if (!running || event.ctrlKey || event.metaKey || event.altKey) return;
  const interval = INTERVALS.find((interval) => event.key === key(interval));
  if (event.key === "Escape") halt("Stopped with Escape.");
  else if (!interval) return;
  else if (!event.repeat) take?.(interval, event.timeStamp);
  event.preventDefault();
}

// A field that shows the key that is pressed in it.
function choose(event) {
  if (["Tab", "Escape", "Shift", "Control", "Alt", "Meta", "Enter"].includes(event.key)) return;
  event.preventDefault();
  event.target.value = event.key;
}

export function bindExperiment() {
  const refresh = part({ view: "record", at: "choice-title", load, again: true, state: show, hide: () => halt("The view was left.") });
  document.addEventListener("array", refresh);
  document.addEventListener("visibilitychange", () => document.hidden && halt("The window was hidden."));
  document.addEventListener("keydown", press, { capture: true });
  $("choice-form").addEventListener("submit", (event) => (event.preventDefault(), start()));
  for (const interval of INTERVALS) {
    $(`key-${interval}`).addEventListener("keydown", choose);
    $(`answer-${interval}`).addEventListener("click", ({ timeStamp }) => take?.(interval, timeStamp));
  }
  $("choice-stop").addEventListener("click", () => halt("Stopped."));
  $("choice-go").addEventListener("click", run);
  $("choice-new").addEventListener("click", () => (keep(null), show()));
}
