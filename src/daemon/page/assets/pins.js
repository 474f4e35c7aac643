// What pins do, in words and colours; a small map of a pattern; and elements of SVG.

import { array, layout, scale } from "./array.js";

// A pin that moves by less is still, and one that stands lower is at rest, µm.
const LEAST_UM = 0.5;
// A lower figure of a status comes of one press, one turn or part of a stroke: two strokes in 0.2 s are a frequency.
const LEAST_HZ = 8;
// Stops of a colour map that rises in lightness, so that it is readable without colours.
const COLOURS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
const STEPS = 64;

export function make(name, attributes = {}, text = "") {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text) element.textContent = text;
  return element;
}

function mixed(share) {
  const at = share * (COLOURS.length - 1);
  const low = Math.min(Math.floor(at), COLOURS.length - 2);
  return `rgb(${COLOURS[low].map((from, i) => Math.round(from + (COLOURS[low + 1][i] - from) * (at - low))).join(" ")})`;
}
const PALETTE = Array.from({ length: STEPS + 1 }, (_, i) => mixed(i / STEPS));

// A colour for a share of the whole, 0 to 1.
export const tint = (share) => PALETTE[Math.round(STEPS * Math.min(Math.max(share, 0), 1)) || 0];

// How much of the array's travel a height is to the eye: the root, so that a stroke of 40 µm is seen beside a travel of 400 µm.
export const share = (um) => Math.sqrt(Math.min(Math.max(um, 0) / array().motor.travel_um, 1));
// The height of a share, µm.
export const heightOf = (share) => share ** 2 * array().motor.travel_um;

// The colours from 0 to the travel, as CSS has them.
export const gradient = () => `linear-gradient(90deg, ${COLOURS.map((colour) => `rgb(${colour.join(" ")})`).join(", ")})`;

// The highest point of a pin, µm above rest. `now`: its movement, as the status has it.
export const highest = ({ height_um: middle, swing_um: swing }) => middle + swing / 2;

export const isMoving = (now) => now.swing_um >= LEAST_UM;
const hertz = ({ swing_um: swing, hz }) => (swing >= LEAST_UM && hz >= LEAST_HZ ? ` at ${+hz.toFixed(1)} Hz` : "");

// A pin's movement in words; `now` is null if it is not known.
export function movement(now) {
  if (!now) return "not known";
  if (!isMoving(now)) return highest(now) >= LEAST_UM ? "stands" : "still";
  return `${(now.height_um - now.swing_um / 2).toFixed(0)} to ${highest(now).toFixed(0)} µm${hertz(now)}`;
}

// What all pins do, in words. `known`: of each pin what it does, or null. `rest_um`: their offsets from rest.
export function summary(known, rest_um) {
  const unknown = known.filter((does) => !does).length;
  if (unknown === known.length) return "What the pins do is not known.";
  const moving = known.filter((does) => does && isMoving(does));
  const raised = known.filter((does) => does && !isMoving(does) && highest(does) >= LEAST_UM);
  const largest = (all) => Math.max(...all).toFixed(0);
  return [
    moving.length ? `${moving.length} of ${known.length} pins move, up to ${largest(moving.map(highest))} µm above rest.` : "No pin moves.",
    raised.length ? `${raised.length} stand above rest, up to ${largest(raised.map(highest))} µm.` : "",
    unknown ? `What ${unknown} do is not known.` : "",
    moving.length || unknown ? "" : `Largest offset from rest ${largest([0, ...rest_um.map(Math.abs)])} µm.`,
  ].filter(Boolean).join(" ");
}

// A small map of the greatest height of each pin, µm.
export function thumbnail(heights) {
  const { places, box: [left, top, width, height] } = layout(scale(10, 6));
  const svg = make("svg", { viewBox: `${left - 5} ${top - 5} ${width + 10} ${height + 10}`, class: "thumbnail", role: "img" });
  const moving = heights.flatMap((um, motor) => (um > 0 ? [motor] : []));
  svg.setAttribute("aria-label", `Pins that move: ${moving.join(", ") || "none"}`);
  places.forEach(([cx, cy], motor) => {
    const um = heights[motor] ?? 0;
    svg.append(make("circle", { cx, cy, ...(um > 0 ? { r: (2 + 2.5 * share(um)).toFixed(1), fill: tint(share(um)), class: "dot" } : { r: 1.2, class: "dot still" }) }));
  });
  return svg;
}
