// Plots of points with error bars and of lines, as SVG, with or without axes.

import { make } from "./finger.js";

// Steps of 1, 2 or 5 times a power of ten, about `count` of them, that lie within a range.
function ticks([low, high], count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((times) => times * power).find((step) => step >= rough * 0.999);
  const first = Math.ceil(low / step - 1e-6);
  const last = Math.floor(high / step + 1e-6);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-6));
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, i) => [(first + i) * step, ((first + i) * step).toFixed(digits)]);
}

// The marker is a filled triangle for upwards, and an open one on its tip for downwards.
const MARKERS = { up: "M0 -1 L1 0.8 L-1 0.8 Z", down: "M0 1 L1 -0.8 L-1 -0.8 Z" };

// Number of plots on the page, for the ids of their clipping paths.
let plots = 0;

// `series`: each with a class `name`, `line` (from x to y) and `points` [x, y, error]. `x` and `y`: ranges. `labels`: of both axes; without
// them the plot has no axes. `level`: a value of y with a line of its own.
export function plot({ title, width, height, x, y, series, labels, level }) {
  const [left, bottom, top, right, size] = labels ? [52, 40, 10, 12, 4] : [3, 3, 3, 3, 2];
  const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, class: "plot", ...(title ? { role: "img", "aria-label": title } : { "aria-hidden": "true" }) });
  const across = (value) => left + ((value - x[0]) / (x[1] - x[0])) * (width - left - right);
  const upward = (value) => height - bottom - ((value - y[0]) / (y[1] - y[0])) * (height - bottom - top);
  const rule = (kind, x1, y1, x2, y2) => svg.append(make("line", { class: kind, x1, y1, x2, y2 }));
  if (labels) {
    for (const [value, text] of ticks(x, 6)) {
      rule("grid", across(value), upward(y[0]), across(value), upward(y[1]));
      svg.append(make("text", { x: across(value), y: height - bottom + 16, "text-anchor": "middle" }, text));
    }
    for (const [value, text] of ticks(y, 5)) {
      rule("grid", across(x[0]), upward(value), across(x[1]), upward(value));
      svg.append(make("text", { x: left - 6, y: upward(value) + 4, "text-anchor": "end" }, text));
    }
    svg.append(make("text", { x: (left + width - right) / 2, y: height - 6, "text-anchor": "middle" }, labels[0]));
    const middle = (top + height - bottom) / 2;
    svg.append(make("text", { x: 13, y: middle, "text-anchor": "middle", transform: `rotate(-90 13 ${middle})` }, labels[1]));
  }
  if (level !== undefined) rule("level", across(x[0]), upward(level), across(x[1]), upward(level));
  const clip = `plot-${++plots}`;
  const frame = make("clipPath", { id: clip });
  frame.append(make("rect", { x: left, y: top, width: width - left - right, height: height - bottom - top }));
  svg.append(frame);
  for (const { name, line, points, from } of series) {
    const group = make("g", { class: name });
    const steps = Array.from({ length: 41 }, (_, i) => from + ((x[1] - from) * i) / 40);
    group.append(make("path", { class: "fit-line", "clip-path": `url(#${clip})`, d: steps.map((at, i) => `${i ? "L" : "M"}${across(at).toFixed(1)} ${upward(line(at)).toFixed(1)}`).join(" ") }));
    for (const [at, value, error] of points) {
      if (error > 0) group.append(make("line", { class: "error", x1: across(at), x2: across(at), y1: upward(value - error), y2: upward(value + error) }));
      group.append(make("path", { class: "point", d: MARKERS[name], transform: `translate(${across(at).toFixed(1)} ${upward(value).toFixed(1)}) scale(${size})` }));
    }
    svg.append(group);
  }
  return svg;
}
