// The header's buttons, which change the device's state, and what all views use: elements, facts, dialogs, checks of fields, and
// answers beside a control.

import { call, headers, known, last, poll } from "./api.js";
import { plain } from "./words.js";

const $ = (id) => document.getElementById(id);
const HOME_MS = 30000;
// This long after the window's last sign of life the daemon disarms the motors that the window has armed, s. While the window is
// visible, each poll is a sign of life.
const SILENCE_S = 10;
// The name of the play that calibrates.
export const CALIBRATION = "calibration";

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
  $("stop").disabled = status !== null && !status.play && !status.queued.length;
  write($("owner"), status ? owner(status) : "");
}

// Whose session runs, and for whom the motors are armed.
function owner({ session, armed }) {
  const runs = session ? `Session of ${session.participant}${session.owner ? `, by ${session.owner}` : ""}${session.exclusive && !session.released ? ", exclusive" : ""}` : "No session";
  return armed ? `${runs} · armed by ${armed.by}` : runs;
}

// An element of HTML.
export function element(name, text = "", more = {}) {
  return Object.assign(document.createElement(name), { textContent: text, ...more });
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
  write(line, text);
  if (text) speak(text, "answer");
}

// Says beside a control that something was refused, or failed, in the page's words.
export function refuse(control, error) {
  say(control, plain(error.message), "bad");
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

// Whether these fields are valid. If not, a line at the first invalid one says what is wrong, until it is changed.
export function valid(...ids) {
  return ids.map($).every((field) => {
    if (field.checkValidity()) return true;
    const { type, min, max, validationMessage } = field;
    const wrong = element("span", type === "number" && !field.validity.stepMismatch ? `Enter a number, ${min} to ${max}.` : validationMessage, { className: "wrong", role: "alert" });
    field.parentElement.querySelector(".wrong")?.remove();
    field.after(wrong);
    field.addEventListener("input", () => wrong.remove(), { once: true });
    field.focus();
    return false;
  });
}

export function bindControls() {
  const alive = new Worker("page/alive.js");
  document.addEventListener("visibilitychange", () => alive.postMessage(document.hidden ? headers() : null));
  // The header shows a success as the new state.
  const command = (id, body, ms) => call("POST", `/v1/${id}`, body, ms).then(() => say($(id), ""), (error) => refuse($(id), error)).finally(poll);
  const button = (id, run) => $(id).addEventListener("click", run);
  button("disarm", () => command("disarm"));
  button("stop", () => command("stop"));
  button("home", () => command("home", undefined, HOME_MS));
  button("arm", () => {
    const isKnown = last().position === "known";
    $("arm-text").textContent = isKnown
      ? "The device knows where its pins are. Take the finger off the pins."
      : "The device does not know where its pins are. Look at them: all must be at rest.";
    $("arm-rest").hidden = $("arm-who").hidden = isKnown;
    $("arm-checked").required = $("arm-name").required = !isKnown;
    open($("arm-dialog"));
  });
  $("arm-dialog").addEventListener("close", () => {
    if ($("arm-dialog").returnValue !== "arm") return;
    // Send what the person has read: if the position is no longer known, the daemon refuses.
    const checked = $("arm-rest").hidden ? {} : { assume_rest: true, checked: $("arm-name").value };
    command("arm", { ...checked, silence_s: SILENCE_S }, HOME_MS);
    $("arm-checked").checked = false;
  });
  button("reset", () => {
    $("reset-why").textContent = `Cause: ${last().cause}.`;
    // A stop that comes while a person reads this dialog must not be cleared with the one that it shows.
    $("reset-dialog").dataset.seen = last().estops;
    open($("reset-dialog"));
  });
  $("reset-dialog").addEventListener("close", () => {
    if ($("reset-dialog").returnValue !== "reset") return;
    command("reset", { force: true, estops_seen: Number($("reset-dialog").dataset.seen) });
  });
}
