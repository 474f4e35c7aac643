// The doctor's findings: each with its verdict as shape, word and colour, what was found, and what to do.

import { call, known } from "./api.js";
import { $, element } from "./control.js";
import { part } from "./views.js";

// A check holds one of the browser's connections to the daemon.
const ANSWER_MS = 2000;
// Shortest time between automatic checks.
const PAUSE_MS = 2000;
// Verdicts, the worst first.
const VERDICTS = { fail: "Failure", warn: "Warning", ok: "OK" };

// Fills an element with a text whose commands, between backticks, are shown as code.
function worded(place, text) {
  place.replaceChildren(...text.split("`").map((part, i) => (i % 2 ? element("code", part) : part)));
  return place;
}

function item({ what, level, found, advice: remedy }) {
  const item = element("li");
  item.dataset.level = level;
  const head = element("p");
  head.append(element("strong", what), " ", element("span", VERDICTS[level] ?? level, { className: "verdict" }));
  const text = element("div");
  text.append(head, worded(element("p"), found));
  if (remedy) {
    const line = worded(element("p", "", { className: "remedy" }), remedy);
    line.prepend(element("strong", "Remedy: "));
    text.append(line);
  }
  item.append(element("span", "", { className: "mark", ariaHidden: "true" }), text);
  return item;
}

let checking = false;
// Whether a person requested the check.
let asked = false;
let checked = "";
let due = null;
let begun = -PAUSE_MS;

async function check() {
  if (checking || document.hidden) return;
  checking = true;
  begun = performance.now();
  $("doctor-again").ariaDisabled = "true";
  $("doctor-note").textContent = "Checking …";
  try {
    const { findings } = await call("GET", "/v1/doctor", undefined, ANSWER_MS);
    const order = Object.keys(VERDICTS);
    const sorted = findings.toSorted((a, b) => order.indexOf(a.level) - order.indexOf(b.level));
    $("findings").replaceChildren(...sorted.map(item));
    const count = (level, one, more) => {
      const number = findings.filter((finding) => finding.level === level).length;
      return `${number} ${number === 1 ? one : more}`;
    };
    checked = new Date().toLocaleTimeString("en-GB");
    $("doctor-note").textContent = `${count("fail", "failure", "failures")}, ${count("warn", "warning", "warnings")}, ${count("ok", "check", "checks")} passed, at ${checked}.`;
  } catch (error) {
    const why = error.code === "slow" ? `The checks took more than ${ANSWER_MS / 1000} s.` : error.message;
    $("doctor-note").textContent = `Not checked: ${why}${checked ? ` The list is of ${checked}.` : ""}`;
  } finally {
    checking = false;
    $("doctor-again").ariaDisabled = null;
    if (asked) $("doctor-say").textContent = $("doctor-note").textContent;
    asked = false;
  }
}

// Schedules a check, because the daemon's state has changed.
function checkSoon() {
  due ??= setTimeout(() => {
    due = null;
    if (checking) checkSoon();
    else check();
  }, Math.max(0, begun + PAUSE_MS - performance.now()));
}

let state = null;
function showState() {
  const status = known();
  if (!status || status.state === state) return;
  state = status.state;
  checkSoon();
}

export function bindDoctor() {
  part({ view: "device", at: "doctor-title", load: checkSoon, state: showState, on: { connected: checkSoon, disconnected: checkSoon } });
  $("doctor-again").addEventListener("click", () => {
    asked = true;
    $("doctor-say").textContent = "";
    check();
  });
}
