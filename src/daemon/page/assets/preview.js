// What a pattern does before anyone plays it: each pin's height over time, and the spikes that the second model predicts. The daemon
// computes both.

import { call } from "./api.js";
import { layout, scale } from "./array.js";
import { element } from "./control.js";
import { make } from "./pins.js";

// The second model takes its time.
const ANSWER_MS = 60000;
const TRACE = { width: 36, height: 22 };
const LARGE = { height: 180, left: 44, bottom: 34, top: 8, right: 14 };
const RASTER = { row: 0.8, gap: 12, left: 44, bottom: 34, top: 8, right: 14 };
export const CLASSES = ["SA1", "RA", "PC"];
// The numbers of the afferents of a class.
export const ofClass = (classes, name) => classes.flatMap((of, i) => (of === name ? [i] : []));
// Drawing units of a plot's width: about one for a pixel, so that its text can be read.
const WIDTHS = [260, 640];
// Points of a path: the highest and the lowest value of each part of the time, so that no movement is lost.
const PARTS = 320;

// A piece of a pattern: from when, and how long, s.
export const preview = (name, from, seconds) => call("GET", `/v1/patterns/${encodeURIComponent(name)}/preview?from_s=${from}&seconds=${seconds}`, undefined, ANSWER_MS);

// The highest point of all pins, µm, at least 1.
const highest = ({ heights_um: heights }) => heights.flat().reduce((high, um) => Math.max(high, um), 1);

// A line through the lowest and the highest of the values in each part.
function path(values, across, upward, parts = PARTS) {
  const size = Math.max(1, Math.ceil(values.length / parts));
  const points = [];
  for (let from = 0; from < values.length; from += size) {
    const part = values.slice(from, from + size);
    const [low, high] = [Math.min(...part), Math.max(...part)];
    const ends = part.indexOf(low) < part.indexOf(high) ? [low, high] : [high, low];
    for (const value of low === high ? [low] : ends) points.push(`${across(from).toFixed(1)} ${upward(value).toFixed(1)}`);
  }
  return `M${points.join(" L")}`;
}

// The heights of all pins, each where its pin stands, from 0 to `high` µm. `choose(motor)`: called when a person clicks on one.
function traces(of, high, title, chosen, choose) {
  const { places, box: [left, top, width, height] } = layout(scale(Math.max(TRACE.width, TRACE.height) + 6, 12));
  const [x, y] = [left - TRACE.width / 2 - 2, top - TRACE.height / 2 - 2];
  const moving = of.heights_um.flatMap((values, motor) => (values.some((um) => um > 0) ? [motor] : []));
  const svg = make("svg", {
    viewBox: `${x} ${y} ${width + TRACE.width + 4} ${height + TRACE.height + 4}`, class: "traces", role: "img",
    "aria-label": `${title}: pins that move: ${moving.join(", ") || "none"}; up to ${highest(of).toFixed(0)} µm`,
  });
  of.heights_um.forEach((values, motor) => {
    const [cx, cy] = places[motor];
    const pin = make("g", { class: `trace${motor === chosen ? " chosen" : ""}`, "data-motor": motor, transform: `translate(${cx - TRACE.width / 2} ${cy - TRACE.height / 2})` });
    pin.append(make("title", {}, `Pin ${motor}`), make("rect", { width: TRACE.width, height: TRACE.height }));
    if (moving.includes(motor)) pin.append(make("path", { d: path(values, (at) => (at / values.length) * TRACE.width, (um) => TRACE.height - 1 - (um / high) * (TRACE.height - 2), 72) }));
    pin.addEventListener("click", () => choose(motor));
    svg.append(pin);
  });
  return svg;
}

// The axis of time, and the places of times on it.
function axis(svg, { left, right, bottom }, [width, height], { seconds, from_s: from }) {
  const base = height - bottom;
  const across = (s) => left + ((s - from) / seconds) * (width - left - right);
  for (let i = 0; i <= 5; i += 1) {
    const at = from + (seconds * i) / 5;
    svg.append(make("line", { class: "grid", x1: across(at), x2: across(at), y1: 0, y2: base }), make("text", { x: across(at), y: base + 14, "text-anchor": "middle" }, (1000 * at).toFixed(0)));
  }
  svg.append(make("text", { x: (left + width - right) / 2, y: height - 4, "text-anchor": "middle" }, "Time, ms"));
  return across;
}

// One pin's height over time, from 0 to `high` µm.
function trace(of, high, title, motor, width) {
  const { height, left, bottom, top, right } = LARGE;
  const values = of.heights_um[motor] ?? [];
  const own = values.reduce((most, um) => Math.max(most, um), 0);
  const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, class: "plot", role: "img", "aria-label": `${title}: height of pin ${motor}, ${own ? `up to ${own.toFixed(0)} µm` : "at rest"}` });
  const across = axis(svg, LARGE, [width, height], of);
  const upward = (um) => height - bottom - (um / high) * (height - bottom - top);
  for (const um of [0, high / 2, high]) svg.append(make("line", { class: "grid", x1: left, x2: width - right, y1: upward(um), y2: upward(um) }), make("text", { x: left - 6, y: upward(um) + 4, "text-anchor": "end" }, um.toFixed(0)));
  const middle = (height - bottom) / 2;
  svg.append(make("text", { x: 10, y: middle, "text-anchor": "middle", transform: `rotate(-90 10 ${middle})` }, "Height, µm"));
  if (values.length) svg.append(make("path", { class: "trace-line", d: path(values, (at) => across(of.from_s + (at * of.step_ms) / 1000), upward) }));
  return svg;
}

// The spikes: a row for each afferent, by class and from the fingertip downwards. Returns the drawing, and how many each class has.
export function raster({ spikes: { class: classes, times_s: times, places_mm: places }, ...of }, title, width) {
  const { row, gap, left, bottom, top } = RASTER;
  const rows = CLASSES.map((name) => ofClass(classes, name).sort((a, b) => places[b][1] - places[a][1]));
  const height = top + bottom + rows.reduce((sum, of) => sum + of.length * row + gap, 0);
  const within = (s) => s >= of.from_s && s < of.from_s + of.seconds;
  const counts = rows.map((of) => of.reduce((sum, i) => sum + times[i].filter(within).length, 0));
  const said = CLASSES.map((name, i) => `${name} ${counts[i]}`).join(", ");
  const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, class: "plot raster", role: "img", "aria-label": `${title}: predicted spikes: ${said}` });
  const across = axis(svg, RASTER, [width, height], of);
  let y = top;
  CLASSES.forEach((name, at) => {
    const high = rows[at].length * row;
    const marks = rows[at].flatMap((i, place) => times[i].filter(within).map((s) => `M${across(s).toFixed(1)} ${(y + place * row).toFixed(1)}v1.6`));
    svg.append(make("text", { x: left - 6, y: y + high / 2 + 4, "text-anchor": "end" }, name));
    if (marks.length) svg.append(make("path", { class: `spikes ${name.toLowerCase()}`, d: marks.join("") }));
    y += high + gap;
  });
  return [svg, said];
}

// A figure with its title and what it says.
export function figure(title, text, ...drawn) {
  const caption = element("figcaption");
  caption.append(element("strong", title), element("span", text));
  const figure = element("figure", "", { className: "preview" });
  figure.append(caption, ...drawn);
  return figure;
}

// The figures of a pattern: all pins, one of them in large, and the spikes. `pixels`: the width there is.
// `choose(motor)`: called when a person clicks on a pin.
export function figures(of, title, motor, pixels, choose) {
  const high = highest(of);
  const width = Math.min(Math.max(pixels, WIDTHS[0]), WIDTHS[1]);
  const [spikes, counts] = raster(of, title, width);
  const said = `Pins up to ${high.toFixed(0)} µm; predicted spikes: ${counts}`;
  return figure(title, said, traces(of, high, title, motor, choose), trace(of, high, title, motor, width), spikes);
}
