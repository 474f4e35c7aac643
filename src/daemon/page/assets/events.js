// What the daemon has told about the device and the session: the newest event in one line, and those before it in a list. The window
// keeps them, so they are there after a reload.

import { known } from "./api.js";
import { $, element, restored, speak, write } from "./control.js";
import { part } from "./views.js";
import { SENSOR_FAULTS } from "./words.js";

const KEPT = "meissner-events";
// Events that are kept.
const MOST = 20;

// A sentence for each event that the rest of the page does not show, or shows only for a moment. What concerns one play is one line.
const WORDS = {
  connected: ({ device }) => `A device has connected: ${device.kind}.`,
  disconnected: ({ reason }) => `The device is gone: ${reason}.`,
  refused: ({ motor, reason }, count) => `the device has refused ${count === 1 ? "a stroke" : `${count} strokes`}, the last one of pin ${motor}: ${reason}.`,
  late: ({ motor, late_ms: ms }, count) => `${count === 1 ? "a stroke" : `${count} strokes`} came too late and was left out, the last one of pin ${motor}, by ${ms.toFixed(1)} ms.`,
  doubted: ({ motor, doubt }) => `Sensor fault of pin ${motor}: ${SENSOR_FAULTS[doubt] ?? doubt}.`,
  drifted: ({ um }) => `Pins may be ${um.toFixed(0)} µm from rest: press Home.`,
  contradiction: ({ kind }) => `The device said something that cannot be true (${kind}). It was ignored.`,
  "record-problem": ({ problem, lost }) => `${problem ? `A fault: ${problem}. ` : ""}The session record has lost ${lost} entries.`,
  intervened: ({ command, by }) => `Another client, ${by}, has used “${command}” during the session.`,
  "session-released": () => "The session's owner was silent: others may act now.",
  "owner-silent": ({ by, silence_s: s }) => `The daemon has disarmed: it had no sign of ${by} for ${s} s.`,
  // A scanner may give one with each volume: those that do nothing are left out.
  edge: ({ number, play, effect }) => (effect === "mark" ? "" : `Edge ${number} of the trigger input ${effect === "start" ? "starts" : "stops"} play ${play}.`),
  lost: ({ notices }) => `The daemon has lost ${notices} of its notices.`,
  lagged: ({ events }) => `This window was too slow, and has missed ${events} events.`,
};

// The newest first: `at`, the time of day; `text`; for an event of a play `key` and `count`. And the daemon's process that has told them.
let { kept = [], pid = null } = restored(KEPT) ?? {};

let waits = null;

function add(event) {
  const key = "id" in event ? `${event.event} ${event.id}` : null;
  const before = key && kept.find((one) => one.key === key);
  const count = (before?.count ?? 0) + 1;
  const words = WORDS[event.event](event, count);
  if (!words) return;
  const text = key ? `Play ${event.id}: ${words}` : words;
  const at = new Date().toTimeString().slice(0, 8);
  kept = [{ at, text, key, count }, ...kept.filter((one) => one !== before)].slice(0, MOST);
  speak(text, "event");
  // Of thousands that come at once, the newest are shown once.
  waits ??= setTimeout(() => {
    waits = null;
    sessionStorage.setItem(KEPT, JSON.stringify({ kept, pid }));
    show();
  });
}

// Another daemon has told nothing yet.
function watch() {
  const now = known()?.daemon.pid ?? pid;
  if (pid !== null && now !== pid) {
    kept = [];
    sessionStorage.removeItem(KEPT);
    show();
  }
  pid = now;
}

function show() {
  $("events").hidden = !kept.length;
  write($("events-newest"), kept.length ? `${kept[0].at} ${kept[0].text}` : "");
  $("events-list").replaceChildren(...kept.map(({ at, text }) => element("li", `${at} ${text}`)));
}

export function bindEvents() {
  part({ view: "play", at: "display-title", always: Object.fromEntries(Object.keys(WORDS).map((name) => [name, add])) });
  document.addEventListener("state", watch);
  show();
}
