// What runs and what waits, and the late strokes of the running play.

import { call, known, poll } from "./api.js";
import { element, facts, operates, refuse, write } from "./control.js";
import { bindSequence, itemsOf, keepItems, showSequence } from "./sequence.js";
import { seconds, timeline } from "./timeline.js";
import { part } from "./views.js";

const $ = (id) => document.getElementById(id);
// Items of a running sequence that are listed, at most.
const ITEMS = 8;
// Late strokes of a play that this window has heard of, by play.
const late = new Map();
// Receipts of plays that run or wait, by play; null while they are on their way, or cannot be had.
const receipts = new Map();

// Fetches a receipt once.
function receiptOf(id) {
  if (!receipts.has(id)) {
    receipts.set(id, null);
    call("GET", `/v1/plays/${id}`).then((receipt) => (receipts.set(id, receipt), show()), () => receipts.delete(id));
  }
  return receipts.get(id);
}

// The plays of a status, with when they begin from now and how long they last, s: null for without end (`length_s`) and not known (`at_s`).
function planned({ play: running, queued }) {
  let at = running ? -running.played_s : null;
  return [...(running ? [running] : []), ...queued].map(({ id, pattern, waits_for_edge: waits = false }) => {
    // When an edge comes, nobody knows.
    if (waits) at = null;
    const receipt = receiptOf(id);
    const ms = receipt ? (receipt.duration_ms.compiled ?? receipt.duration_ms.ordered) : undefined;
    const length = ms === undefined || ms === null ? null : ms / 1000;
    const play = { id, name: pattern, at_s: at, length_s: length, isKnown: ms !== undefined, items: itemsOf(id), count: receipt?.items_planned ?? null, waits };
    // A play that is due begins soon.
    at = at === null || length === null ? null : Math.max(0, at + length);
    return play;
  });
}

function lengthOf({ length_s: length, isKnown }) {
  return length !== null ? seconds(length) : isKnown ? "without end" : "length not known";
}

function words(play, isRunning) {
  const items = play.count === null ? "" : `, ${play.count} items`;
  if (isRunning) return `${lengthOf(play)}${items}; began ${seconds(-play.at_s)} ago`;
  const begins = play.waits ? "waits for an edge of the trigger input" : play.at_s === null ? "begins when those before it are over" : `begins in about ${seconds(play.at_s)}`;
  return `${lengthOf(play)}${items}; ${begins}`;
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
    const isRunning = play.id === runningId;
    write(item.querySelector("span"), words(play, isRunning));
    const button = item.querySelector("button");
    if (isRunning) button?.remove();
    else if (!button) item.firstChild.after(removal(play));
    return item;
  });
  const shown = [...$("queue").children];
  if (lines.length !== shown.length || lines.some((item, i) => item !== shown[i])) $("queue").replaceChildren(...lines);
}

// The items of a sequence that runs: the one that is on, and the next ones.
function showItems(play) {
  const items = play?.items;
  $("items-part").hidden = !play || play.count === null;
  if (!play || play.count === null) return;
  write($("items-title"), `Items of ${play.name}`);
  const now = -play.at_s;
  const at = items ? Math.max(0, items.findIndex((item) => item.at_s + item.length_s > now)) : 0;
  const next = items?.slice(at, at + ITEMS) ?? [];
  const begins = (s) => (s > now ? `in ${seconds(s - now)}` : "now");
  const lines = next.map((item, i) => `${at + i + 1}. ${item.name}, ${seconds(item.length_s)}: ${begins(item.at_s)}`);
  const rest = items ? items.length - at - next.length : 0;
  write($("items-note"), items ? (rest ? `${rest} more follow.` : "") : `Another window or program has ordered these ${play.count} items: its receipt lists them when it is over.`);
  while ($("items").children.length > lines.length) $("items").lastChild.remove();
  lines.forEach((text, i) => {
    if (!$("items").children[i]) $("items").append(document.createElement("li"));
    write($("items").children[i], text);
  });
}

function show() {
  const status = known();
  const plays = status ? planned(status) : [];
  const running = status?.play ? plays[0] : null;
  if (status) {
    const ids = plays.map((play) => play.id);
    for (const id of receipts.keys()) if (!ids.includes(id)) receipts.delete(id);
    keepItems(ids);
  }
  $("timeline").replaceChildren(...(plays.length ? [timeline(plays.map((play) => (play.isKnown ? play : { ...play, at_s: null })), Math.max(200, $("timeline").clientWidth))] : []));
  showLines(plays, running?.id);
  write($("queue-none"), !status ? "Not known." : plays.length ? (status.queued.length ? "" : "No play waits.") : "No play runs or waits.");
  showItems(running);
  showSequence();
  facts($("play-facts"), running ? [["Late strokes that this window has heard of", late.get(running.id) ?? "none"]] : []);
}

export function bindQueue() {
  bindSequence();
  part({
    view: "play",
    at: "queue-title",
    state: show,
    always: {
      // Of another start of the daemon the numbers begin anew.
      linked: () => late.clear(),
      late: ({ id }) => void late.set(id, (late.get(id) ?? 0) + 1),
      ended: ({ receipt }) => void late.delete(receipt.id),
    },
  });
}
