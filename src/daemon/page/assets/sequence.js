// A sequence, from a file or put together here: what it has, its play, and its file.

import { call, order } from "./api.js";
import { ordered, orders, restored, write } from "./control.js";
import { number } from "./number.js";
import { seconds, timeline } from "./timeline.js";
import { keep } from "./toml.js";

const $ = (id) => document.getElementById(id);

const KEPT = "meissner-sequence";
// A longer one is not kept: the window needs the place for its session's token.
const MOST_KEPT = 1e6;

// The sequence that a person has loaded or put together: `request`, `items` as `plan` has them, and `from`, where it is from. Null: none.
let loaded = restored(KEPT);
if (!loaded?.request?.items?.length) loaded = null;
// What is drawn, and how wide.
let drawn = null;
// The items of the sequences that this window has ordered, by play.
const sent = new Map();

// The items of a sequence that this window has ordered, with their begins and lengths, s. The daemon tells them when it is over.
export const itemsOf = (id) => sent.get(id);

// Keeps the items of plays that are not over.
export function keepItems(ids) {
  for (const id of sent.keys()) if (!ids.includes(id)) sent.delete(id);
}

// How long a pattern lasts, s; null: without end, or not known.
async function lengthOf(pattern) {
  const { duration_s: duration, compiled_ms: ms } = typeof pattern === "string"
    ? await call("GET", `/v1/patterns/${encodeURIComponent(pattern)}`).then(({ pattern: { duration_s }, compiled_ms }) => ({ duration_s, compiled_ms }))
    : pattern;
  return duration ?? (typeof ms === "number" ? ms / 1000 : null);
}

// When the items begin, from the sequence's onset, and how long they last, s; null: not known.
async function plan(items) {
  const lengths = new Map();
  const planned = [];
  let end = 0;
  for (const { pattern, seconds: own, gap_ms: gap = 0, start_ms: start } of items) {
    if (typeof own !== "number" && !lengths.has(pattern)) lengths.set(pattern, await lengthOf(pattern));
    const at = typeof start === "number" ? start / 1000 : end === null ? null : end + (gap ?? 0) / 1000;
    const length = own ?? lengths.get(pattern);
    planned.push({ name: typeof pattern === "string" ? pattern : (pattern?.name ?? (pattern ? "inline" : "blank")), at_s: at, length_s: length });
    end = at === null || length === null || end === null ? null : Math.max(end, at + length);
  }
  return planned;
}

// Takes a sequence, and keeps it for a reload.
async function take(request, from) {
  const mine = (loaded = request.items.length ? { request, items: [], from } : null);
  showSequence();
  // The daemon says what is wrong with an item when it is played.
  const items = await plan(request.items).catch(() => []);
  if (mine !== loaded) return;
  if (mine) mine.items = items;
  const text = JSON.stringify(mine);
  if (text.length <= MOST_KEPT) sessionStorage.setItem(KEPT, text);
  else sessionStorage.removeItem(KEPT);
  drawn = null;
  showSequence();
}

// Takes the text of a file, which plays only when a person presses the button.
export async function loadSequence(file, text) {
  let request;
  try {
    request = JSON.parse(text);
  } catch (error) {
    throw new Error(`${file} is not JSON: ${error.message}.`);
  }
  if (!Array.isArray(request?.items) || !request.items.length) throw new Error(`${file} is not a sequence: it has no list “items”.`);
  await take(request, ` (${file})`);
}

// Adds an item at the end of the sequence, after the gap of the field, and says so. `item`: its keys.
export async function addItem(item) {
  const { request = { items: [] }, from = "" } = loaded ?? {};
  const gap = request.items.length ? { gap_ms: number("sequence-gap") } : {};
  const items = [...request.items, { ...item, ...gap }];
  await take({ ...request, items }, from);
  return `It is item ${items.length} of the sequence.`;
}

// Shows the sequence; draws it again if it or its place has changed.
export function showSequence() {
  const width = Math.max(200, $("sequence-line").clientWidth);
  if (drawn?.loaded === loaded && drawn.width === width) return;
  drawn = { loaded, width };
  for (const id of ["play", "keep", "back", "clear"]) $(`sequence-${id}`).disabled = !loaded;
  const { request, items = [], from } = loaded ?? {};
  const isKnown = items.length > 0 && items.every((item) => item.at_s !== null && item.length_s !== null);
  const end = isKnown ? Math.max(...items.map((item) => item.at_s + item.length_s)) : null;
  write($("sequence-what"), loaded ? `${request.name ?? "sequence"}${from}: ${request.items.length} items${isKnown ? `, ${seconds(end)}` : items.length ? ", length not known" : ""}.`
    : "Load a file, or add the pattern that you have chosen.");
  const plays = [{ name: "sequence", at_s: 0, length_s: end, items }];
  $("sequence-line").replaceChildren(...(isKnown ? [timeline(plays, width, false)] : []));
}

export function bindSequence() {
  orders($("sequence-play"), async () => {
    const { request, items } = loaded;
    const answer = await order("/v1/sequence", request);
    if (items.length && items.every((item) => item.length_s !== null && item.at_s !== null)) sent.set(answer.id, items);
    return ordered(answer);
  });
  $("sequence-keep").addEventListener("click", () => keep(JSON.stringify(loaded.request, null, 1), "application/json", `${loaded.request.name ?? "sequence"}.json`));
  $("sequence-back").addEventListener("click", () => take({ ...loaded.request, items: loaded.request.items.slice(0, -1) }, loaded.from));
  $("sequence-clear").addEventListener("click", () => take({ items: [] }, ""));
}
