// What runs and what waits, as bars along a line of time.

import { make } from "./finger.js";

const HEIGHT = { play: 26, item: 12, gap: 4, axis: 18 };
// So much of a play without end is shown, and so much at least, s.
const ENDLESS_S = 10;
const LEAST_S = 2;
// Of more items than these, those that begin within so many px are one bar.
const BARS = 100;
const APART = 4;

export const seconds = (s) => `${s.toFixed(s < 9.95 ? 1 : 0)} s`;

// `plays`: each with `name`, when it begins (`at_s`, from now) and how long it lasts (`length_s`; null: without end), in their order, and
// `items` in the same way. Plays whose begin is not known are left out. `width`: px. `runs`: whether the line begins now.
export function timeline(plays, width, runs = true) {
  const shown = plays.filter((play) => play.at_s !== null);
  const endless = shown.some((play) => play.length_s === null);
  const from = Math.min(0, ...shown.map((play) => play.at_s));
  const known = shown.map((play) => play.at_s + (play.length_s ?? 0));
  const to = Math.max(LEAST_S, ...known) + (endless ? ENDLESS_S : 0);
  const across = (s) => ((s - from) / (to - from)) * width;
  const items = [];
  const apart = shown.reduce((sum, play) => sum + (play.items?.length ?? 0), 0) > BARS ? APART : 0;
  for (const play of shown) {
    let first = null;
    for (const { name, at_s: begin, length_s: length } of play.items ?? []) {
      const at = play.at_s + begin;
      if (first && across(at) < across(first.at_s) + apart) Object.assign(first, { length_s: Math.max(first.length_s, at + length - first.at_s), count: first.count + 1 });
      else items.push((first = { name, at_s: at, length_s: length, count: 1 }));
    }
  }
  const high = HEIGHT.play + (items.length ? HEIGHT.item + HEIGHT.gap : 0) + HEIGHT.axis;
  const words = shown.map((play) => `${play.name}, ${play.length_s === null ? "without end" : seconds(play.length_s)}`);
  const svg = make("svg", { viewBox: `0 0 ${width} ${high}`, class: "timeline", role: "img", "aria-label": `Timeline: ${words.join("; ") || "empty"}` });
  const bar = (kind, { name, at_s: at, length_s: length, count = 1 }, y, height) => {
    const [left, right] = [across(at), across(at + (length ?? to - at))];
    const group = make("g", { class: runs && at <= 0 && (length === null || at + length > 0) ? `${kind} now` : kind });
    group.append(make("title", {}, count > 1 ? `${count} items from ${name} on` : name), make("rect", { x: left, y, width: Math.max(1, right - left - 1), height }));
    // A name that does not fit is in the list below.
    if (kind === "play" && right - left > 8 * name.length + 10) group.append(make("text", { x: left + 6, y: y + height / 2 + 4 }, name));
    svg.append(group);
  };
  for (const play of shown) bar("play", play, 0, HEIGHT.play);
  for (const item of items) bar("item", item, HEIGHT.play + HEIGHT.gap, HEIGHT.item);
  if (runs) svg.append(make("line", { class: "present", x1: across(0), x2: across(0), y1: 0, y2: high - HEIGHT.axis + 4 }));
  const end = make("text", { x: width - 2, y: high - 3, "text-anchor": "end" }, endless ? "without end" : runs ? `in ${seconds(to)}` : seconds(to));
  if (runs && across(0) < width - 120) svg.append(make("text", { x: Math.max(2, across(0)), y: high - 3 }, "now"));
  svg.append(end);
  return svg;
}
