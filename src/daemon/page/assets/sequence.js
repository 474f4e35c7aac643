// A sequence from a file: what it has, and its play.

import { call, order } from "./api.js";
import { refuse, say } from "./control.js";
import { seconds } from "./timeline.js";

const $ = (id) => document.getElementById(id);

// The sequence that a person has loaded, and the items of those that this window has ordered, by play.
let loaded = null;
const ordered = new Map();

// The items of a sequence that this window has ordered, with their begins and lengths, s. The daemon tells them when it is over.
export const itemsOf = (id) => ordered.get(id);

// Keeps the items of plays that are not over.
export function keepItems(ids) {
  for (const id of ordered.keys()) if (!ids.includes(id)) ordered.delete(id);
}

// How long a pattern lasts, s.
async function lengthOf(pattern) {
  const { duration_s: duration, compiled_ms: ms } = typeof pattern === "string"
    ? await call("GET", `/v1/patterns/${encodeURIComponent(pattern)}`).then(({ pattern: { duration_s }, compiled_ms }) => ({ duration_s, compiled_ms }))
    : pattern;
  return duration ?? ms / 1000;
}

// When the items begin, from the sequence's onset, and how long they last, s.
async function plan(items) {
  const lengths = new Map();
  const planned = [];
  let end = 0;
  for (const { pattern, seconds: own, gap_ms: gap = 0, start_ms: start } of items) {
    if (own === undefined && !lengths.has(pattern)) lengths.set(pattern, await lengthOf(pattern));
    const [at, length] = [start === undefined ? end + gap / 1000 : start / 1000, own ?? lengths.get(pattern)];
    planned.push({ name: typeof pattern === "string" ? pattern : (pattern?.name ?? (pattern ? "inline" : "blank")), at_s: at, length_s: length });
    end = Math.max(end, at + length);
  }
  return planned;
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
  // The daemon says what is wrong with an item when it is played.
  const items = await plan(request.items).catch(() => []);
  const end = Math.max(...items.map((item) => item.at_s + item.length_s));
  loaded = { request, items };
  $("sequence-what").textContent = `${request.name ?? "sequence"} (${file}): ${request.items.length} items${items.length ? `, ${seconds(end)}` : ""}.`;
  showSequence();
}

export function showSequence() {
  $("sequence-play").disabled = !loaded;
}

export function bindSequence() {
  $("sequence-play").addEventListener("click", async () => {
    const { request, items } = loaded;
    try {
      const { id } = await order("/v1/sequence", request);
      if (items.length) ordered.set(id, items);
      say($("sequence-play"), "");
    } catch (error) {
      refuse($("sequence-play"), error);
    }
  });
}
