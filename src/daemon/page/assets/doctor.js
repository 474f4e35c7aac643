// The doctor's findings: each with its verdict as shape, word and colour, what was found, and what to do.

import { call } from "./api.js";

const $ = (id) => document.getElementById(id);
// A check waits up to 3 s for systemd, and another one may run before it.
const ANSWER_MS = 12000;
// Verdicts, the worst first.
const VERDICTS = { fail: "Failure", warn: "Warning", ok: "OK" };

// Fills an element with a text whose commands, between backticks, are shown as code.
export function worded(element, text) {
  const parts = text.split("`").map((part, i) => (i % 2 ? Object.assign(document.createElement("code"), { textContent: part }) : part));
  element.replaceChildren(...parts);
  return element;
}

function item({ what, level, found, advice }) {
  const item = document.createElement("li");
  item.dataset.level = level;
  const mark = Object.assign(document.createElement("span"), { className: "mark", ariaHidden: "true" });
  const head = document.createElement("p");
  const verdict = Object.assign(document.createElement("span"), { className: "verdict", textContent: VERDICTS[level] ?? level });
  head.append(Object.assign(document.createElement("strong"), { textContent: what }), " ", verdict);
  const text = document.createElement("div");
  text.append(head, worded(document.createElement("p"), found));
  if (advice) {
    const remedy = worded(document.createElement("p"), advice);
    remedy.className = "remedy";
    remedy.prepend(Object.assign(document.createElement("strong"), { textContent: "Remedy: " }));
    text.append(remedy);
  }
  item.append(mark, text);
  return item;
}

export async function loadDoctor() {
  $("doctor-again").disabled = true;
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
    $("doctor-note").textContent = `${count("fail", "failure", "failures")}, ${count("warn", "warning", "warnings")}, ${count("ok", "check", "checks")} without fault, at ${new Date().toLocaleTimeString("en-GB")}.`;
  } catch (error) {
    $("doctor-note").textContent = "Not checked.";
    throw error;
  } finally {
    $("doctor-again").disabled = false;
  }
}

export function bindDoctor(report) {
  $("doctor-again").addEventListener("click", () => loadDoctor().then(() => report(null), report));
}
