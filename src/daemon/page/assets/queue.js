// What runs and what waits.

import { call, known, poll } from "./api.js";
import { $, element, operates, refuse, write } from "./control.js";
import { part } from "./views.js";

// Receipts of plays that run or wait, by play; null while they are on their way, or cannot be had.
const receipts = new Map();

const seconds = (s) => `${s.toFixed(s < 9.95 ? 1 : 0)} s`;

// Fetches a receipt once.
function receiptOf(id) {
  if (!receipts.has(id)) {
    receipts.set(id, null);
    call("GET", `/v1/plays/${id}`).then((receipt) => (receipts.set(id, receipt), show()), () => receipts.delete(id));
  }
  return receipts.get(id);
}

// The plays of a status, with how long they last and when they begin, in words.
function planned({ play: running, queued }) {
  // When the next one begins, s from now; null if that is not known.
  let at = running ? -running.played_s : null;
  return [...(running ? [running] : []), ...queued].map(({ id, name, waits_for_edge: waits = false }) => {
    const receipt = receiptOf(id);
    const ms = receipt ? (receipt.duration_ms.compiled ?? receipt.duration_ms.ordered) : undefined;
    const length = `${ms ? seconds(ms / 1000) : receipt ? "without end" : "length not known"}${receipt?.order.items > 1 ? `, ${receipt.order.items} items` : ""}`;
    const begins = id === running?.id ? `began ${seconds(running.played_s)} ago`
      : waits ? "waits for an edge of the trigger input" : at === null ? "begins when those before it are over" : `begins in about ${seconds(at)}`;
    // When an edge comes, nobody knows. A play that is due begins soon.
    at = waits || at === null || !ms ? null : Math.max(0, at + ms / 1000);
    return { id, name, words: `${length}; ${begins}` };
  });
}

// The line of a play, which stays the same element, with what has the focus there.
function line(play) {
  const item = element("li", "");
  item.dataset.play = play.id;
  const text = document.createElement("div");
  text.append(element("strong", `${play.name} (play ${play.id})`), element("span"));
  item.append(text);
  return item;
}

function removal(play) {
  const button = operates(element("button", "Remove", { type: "button", ariaLabel: `Remove ${play.name}, play ${play.id}, from the queue` }));
  button.addEventListener("click", () => call("DELETE", `/v1/plays/${play.id}`).then(poll, (error) => refuse(button, error)));
  return button;
}

function showLines(plays, runningId) {
  const before = new Map([...$("queue").querySelectorAll("[data-play]")].map((item) => [Number(item.dataset.play), item]));
  const lines = plays.map((play) => {
    const item = before.get(play.id) ?? line(play);
    write(item.querySelector("span"), play.words);
    const button = item.querySelector("button");
    if (play.id === runningId) button?.remove();
    else if (!button) item.firstChild.after(removal(play));
    return item;
  });
  const shown = [...$("queue").children];
  if (lines.length !== shown.length || lines.some((item, i) => item !== shown[i])) $("queue").replaceChildren(...lines);
}

function show() {
  const status = known();
  const plays = status ? planned(status) : [];
  const running = status?.play?.id;
  if (status) for (const id of receipts.keys()) if (!plays.some((play) => play.id === id)) receipts.delete(id);
  showLines(plays, running);
  write($("queue-none"), !status ? "Not known." : plays.length ? (status.queued.length ? "" : "No play waits.") : "No play runs or waits.");
}

export function bindQueue() {
  part({ view: "play", at: "queue-title", state: show });
}
