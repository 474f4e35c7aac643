// The header's buttons, which change the device's state, and what all views use: elements, facts, dialogs, and answers beside a
// control.
//
// A control that this window may not use is not offered: `data-needs="operate"` marks what changes something, and `data-needs="stop"`
// what only stops or disarms. `showRights` decides, the header says why, and `page.css` hides the marked elements. E-STOP is never
// hidden: whoever may read may stop, and without a valid token it says so.

import { call, headers, known, last, poll } from "./api.js";
import { plain } from "./words.js";

export const $ = (id) => document.getElementById(id);
const HOME_MS = 30000;
// This long after the window's last sign of life the daemon disarms the motors that the window has armed, s. While the window is
// visible, each poll is a sign of life.
const SILENCE_S = 10;

// An order without an answer after this time says that it is under way.
const SLOW_MS = 500;
// The shortest time between two sentences for screen readers.
const SPEAK_MS = 1000;

// Shows the status in the header.
export function showControls() {
  const status = known();
  $("arm").disabled = status?.state !== "disarmed";
  $("home").disabled = status?.state !== "armed" || status.play !== null;
  $("reset").disabled = status?.state !== "faulted";
  // The buttons that stop the pins work even while the state is not known.
  $("disarm").disabled = status !== null && status.state !== "armed";
  const waiting = status?.queued.length ?? 0;
  $("stop").disabled = status !== null && !status.play && !waiting;
  write($("stop"), waiting ? `Stop, clear ${waiting}` : "Stop play");
  write($("owner"), status ? owner(status) : "");
  write($("armed-by"), status ? who(status) : "");
  $("owner").classList.toggle("warns", status?.state === "armed" && !status.session);
  if (status) {
    showRights(status);
    unrefuse(status);
  }
}

// How long, in words.
const long = (s) => (s < 60 ? `${s.toFixed(0)} s` : s < 3600 ? `${(s / 60).toFixed(0)} min` : `${(s / 3600).toFixed(1)} h`);

// Who has armed or stopped, and when.
function who({ state, cause, armed, estop }) {
  if (state === "faulted" && cause === "estop" && estop.age_s !== null) return `stopped ${estop.by ? `by ${estop.by} ` : ""}${long(estop.age_s)} ago`;
  return armed ? `armed by ${armed.by}, for ${long(armed.for_s)}` : "";
}

// Whose session runs.
function owner({ session, state }) {
  const by = session?.mine ? ", by this window" : session?.owner ? `, by ${session.owner}` : "";
  const none = state === "armed" ? "No session: plays belong to no participant" : "No session";
  return session ? `Session of ${session.participant}${by}${session.exclusive && !session.released ? ", exclusive" : ""}` : none;
}

// Marks a control that changes something, and returns it.
export function operates(control) {
  control.dataset.needs = "operate";
  return control;
}

// Shows what this window may do: everything, only stop and disarm, or only read. While the state is not known, that stays.
function showRights({ daemon: { role }, session }) {
  const isForeign = session?.exclusive && !session.released && !session.mine;
  const [may, why] = role === "observe" ? ["read", "This window may only read, and order an emergency stop: its access token has the role “observe”. A new window asks for another one."]
    : isForeign ? ["stop", `${session.owner ?? "Another client"} owns the exclusive session with ${session.participant}: this window may read, stop and disarm.`]
      : ["all", ""];
  document.documentElement.dataset.may = may;
  $("may-not").hidden = !why;
  write($("may-not"), why);
}

// Whether this window may change things: while the state was never known, it may try.
export const may = () => (document.documentElement.dataset.may ?? "all") === "all";

// What this window has kept under a key; null for nothing, and for what is no JSON.
export function restored(key) {
  try {
    return JSON.parse(sessionStorage.getItem(key));
  } catch {
    return null;
  }
}

// An element of HTML.
export function element(name, text = "", more = {}) {
  return Object.assign(document.createElement(name), { textContent: text, ...more });
}

// Gives the person a file. `parts`: its text.
export function saveFile(parts, type, name) {
  const href = URL.createObjectURL(new Blob(parts, { type }));
  element("a", "", { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), 10000);
}

export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

// Fills a list of facts; unchanged values are not touched, so that a screen reader does not read them again.
export function facts(list, rows) {
  while (list.children.length > 2 * rows.length) list.lastChild.remove();
  rows.forEach(([name, value], i) => {
    if (!list.children[2 * i]) list.append(document.createElement("dt"), document.createElement("dd"));
    write(list.children[2 * i], name);
    write(list.children[2 * i + 1], String(value));
  });
}

// Opens a dialog that leaves the emergency stop within reach: a modal one would not. It takes all other clicks and keys until it is
// closed; then the focus is where it was.
export function open(dialog) {
  const before = document.activeElement;
  const rest = document.querySelectorAll("[data-rest]");
  const escape = ({ key }) => key === "Escape" && dialog.close("cancel");
  for (const part of rest) part.inert = true;
  document.addEventListener("keydown", escape);
  dialog.addEventListener("close", () => {
    for (const part of rest) part.inert = false;
    document.removeEventListener("keydown", escape);
    before?.focus();
  }, { once: true });
  dialog.returnValue = "";
  dialog.show();
  [...dialog.querySelectorAll("input, button")].find((field) => field.checkVisibility()).focus();
  // The focus may have scrolled past the warning.
  dialog.scrollTop = 0;
}

// Reads a text to screen readers. Within a second only the last text of each `topic` is read.
const unspoken = new Map();
let spoken = -Infinity;
export function speak(text, topic = "") {
  if (!unspoken.size) setTimeout(readOut, Math.max(0, spoken + SPEAK_MS - performance.now()));
  unspoken.set(topic, text);
}

function readOut() {
  spoken = performance.now();
  const text = [...unspoken.values()].join(" ");
  unspoken.clear();
  // A text that comes twice is read twice.
  $("speak").textContent = $("speak").textContent === text ? `${text}\u00a0` : text;
}

// Says beside a control what came of it, and reads it to screen readers: `good`, `bad` or `wait` (it goes on). The line stands below the
// control's group (`.buttons` or `.row`), or at the end of its list item or table cell, and replaces the one before. An empty text
// takes it away.
export function say(control, text, kind = "good") {
  const line = answerLine(control, text);
  if (!line) return;
  line.hidden = !text;
  line.dataset.kind = kind;
  delete line.dataset.state;
  write(line, text);
  if (text) speak(text, "answer");
}

// Refusals because of the state, which another state may take back.
const OF_STATE = new Set(["disarmed", "faulted", "returning", "playing", "not-home", "nothing-to-go-by", "session-exclusive", "session-running", "position-unknown", "no-device", "behind-endless", "queue-full", "rendering-running", "not-known", "unreachable", "slow", "stopped"]);

// Says beside a control that something was refused, or failed, in the page's words.
export function refuse(control, error) {
  say(control, plain(error), "bad");
  if (!OF_STATE.has(error.code)) return;
  const line = answerLine(control, true);
  const text = line.textContent;
  // The state in which it was refused may be news.
  poll().then(() => {
    if (last() && line.textContent === text) line.dataset.state = refusing(last());
  });
}

// What a refusal may be about.
const refusing = ({ state, position, play, session, queued, device }) => JSON.stringify([state, position, device?.boot, play?.id, session?.id, session?.released, queued.length]);

// Takes back the refusals of another state.
function unrefuse(status) {
  for (const line of document.querySelectorAll(".say[data-state]")) if (line.dataset.state !== refusing(status)) silence(line);
}

function silence(line) {
  line.hidden = true;
  line.textContent = "";
  delete line.dataset.state;
}

// Binds a button that orders something, and returns what its click does once the motors are armed. `order`: orders it. An order that takes
// long says so. `ready`: throws if it cannot be ordered as it is, or is false if that was said; with it, the button asks to arm first if the
// motors are off.
export function orders(button, order, ready) {
  const run = async () => {
    const wait = setTimeout(() => say(button, "The daemon prepares the play …", "wait"), SLOW_MS);
    try {
      await order();
      say(button, "");
    } catch (error) {
      refuse(button, error);
    } finally {
      clearTimeout(wait);
    }
  };
  button.addEventListener("click", () => {
    try {
      if (ready?.() === false) return undefined;
    } catch (error) {
      return refuse(button, error);
    }
    return ready && known()?.state === "disarmed" ? askToArm(run) : run();
  });
  return run;
}

// What follows once the motors are armed, if anything.
let then = null;
function askToArm(next = null) {
  const { position, standing } = last();
  const isKnown = position === "known";
  then = next;
  for (const id of ["arm-title", "arm-yes"]) $(id).textContent = next ? "Arm and feel" : "Arm";
  $("arm-text").textContent = isKnown
    ? `${standing ? `Pins stand up to ${Math.ceil(standing.height_um)} µm above rest: the device returns them first.` : "The device knows where its pins are."} Take the finger off the pins.`
    : "The device does not know where its pins are. Look at them: all must be at rest.";
  $("arm-rest").hidden = $("arm-who").hidden = isKnown;
  $("arm-checked").required = $("arm-name").required = !isKnown;
  open($("arm-dialog"));
}

// The second click of a double click and a key that is held down order nothing: each would be another play. `api.js` sends no request
// twice at once.
function guardButtons() {
  const take = (event) => {
    if (!event.target.closest?.("button:not(#estop)")) return;
    event.preventDefault();
    event.stopImmediatePropagation();
  };
  document.addEventListener("click", (event) => event.detail > 1 && take(event), { capture: true });
  document.addEventListener("keydown", (event) => event.repeat && (event.key === "Enter" || event.key === " ") && take(event), { capture: true });
}

function answerLine(control, isNeeded) {
  const item = control.closest("li, td");
  const group = control.closest(".buttons, .row") ?? control;
  const found = item ? item.querySelector(":scope > .say") : group.nextElementSibling;
  if (found?.matches(".say")) return found;
  if (!isNeeded) return null;
  const line = element("p", "", { className: "say", hidden: true });
  if (item) item.append(line);
  else group.after(line);
  return line;
}

export function bindControls() {
  guardButtons();
  const alive = new Worker(new URL("./alive.js", import.meta.url));
  document.addEventListener("visibilitychange", () => alive.postMessage(document.hidden ? headers() : null));
  // The header shows a success as the new state.
  const command = (id, body, ms) => call("POST", `/v1/${id}`, body, ms).then(() => (say($(id), ""), true), (error) => refuse($(id), error)).finally(poll);
  const button = (id, run) => $(id).addEventListener("click", run);
  button("disarm", () => command("disarm"));
  button("stop", () => command("stop"));
  button("home", () => command("home", undefined, HOME_MS));
  button("arm", () => askToArm());
  $("arm-dialog").addEventListener("close", async () => {
    const next = then;
    then = null;
    if ($("arm-dialog").returnValue !== "arm") return;
    // Send what the person has read: if the position is no longer known, the daemon refuses.
    const checked = $("arm-rest").hidden ? {} : { assume_rest: true, checked: $("arm-name").value };
    $("arm-checked").checked = false;
    if (await command("arm", { ...checked, silence_s: SILENCE_S }, HOME_MS)) next?.();
  });
  button("reset", () => {
    $("reset-why").textContent = `Cause: ${last().cause}.`;
    // A stop that comes while a person reads this dialog must not be cleared with the one that it shows.
    $("reset-dialog").dataset.seen = last().estop.orders;
    open($("reset-dialog"));
  });
  $("reset-dialog").addEventListener("close", () => {
    if ($("reset-dialog").returnValue !== "reset") return;
    command("reset", { force: true, estops_seen: Number($("reset-dialog").dataset.seen) });
  });
}
