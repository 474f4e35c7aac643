// What runs and what waits, as bars along a line of time.

import { make } from "./finger.js";

const HEIGHT = { play: 26, item: 12, gap: 4, axis: 18 };
// So much of a play without end is shown, and so much at least, s.
const ENDLESS_S = 10;
const LEAST_S = 2;

export const seconds = (s) => `${s.toFixed(s < 9.95 ? 1 : 0)} s`;

// `plays`: each with `name`, when it begins (`at_s`, from now) and how long it lasts (`length_s`; null: without end), in their order, and
// `items` in the same way. Plays whose begin is not known are left out. `width`: px. `runs`: whether the line begins now.
export function timeline(plays, width, runs = true) {
  const shown = plays.filter((play) => play.at_s !== null);
  const items = shown.flatMap((play) => (play.items ?? []).map((item) => ({ ...item, at_s: play.at_s + item.at_s })));
  const endless = shown.some((play) => play.length_s === null);
  const from = Math.min(0, ...shown.map((play) => play.at_s));
  const known = shown.map((play) => play.at_s + (play.length_s ?? 0));
  const to = Math.max(LEAST_S, ...known) + (endless ? ENDLESS_S : 0);
  const high = HEIGHT.play + (items.length ? HEIGHT.item + HEIGHT.gap : 0) + HEIGHT.axis;
  const across = (s) => ((s - from) / (to - from)) * width;
  const words = shown.map((play) => `${play.name}, ${play.length_s === null ? "without end" : seconds(play.length_s)}`);
  const svg = make("svg", { viewBox: `0 0 ${width} ${high}`, class: "timeline", role: "img", "aria-label": `Timeline: ${words.join("; ") || "empty"}` });
  const bar = (kind, { name, at_s: at, length_s: length }, y, height) => {
    const [left, right] = [across(at), across(at + (length ?? to - at))];
    const group = make("g", { class: runs && at <= 0 && (length === null || at + length > 0) ? `${kind} now` : kind });
    group.append(make("title", {}, name), make("rect", { x: left, y, width: Math.max(1, right - left - 1), height }));
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
