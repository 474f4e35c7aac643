// The array that the daemon drives: its pins, its motors, its name. The document gets the event `array` when the array is known, and
// when the daemon drives another one.

import { call } from "./api.js";

let known = null;

// As `GET /v1/array` shows it; null until it is known.
export const array = () => known;

// Whether a pattern is for another array than the daemon's: then it does not play.
export const isForeign = (pattern) => pattern.array !== known.name;

// Throws for a pattern of another array: the daemon would refuse it.
export function checkArray(pattern) {
  if (isForeign(pattern)) throw new Error(`“${pattern.name}” is for the array ${pattern.array}, and this one is ${known.name}. Render or design one for this array.`);
}

export async function loadArray() {
  const found = await call("GET", "/v1/array");
  if (found.hash === known?.hash) return;
  known = found;
  document.dispatchEvent(new Event("array"));
}

// Drawing units per mm, with `pitch` units between neighbours. Two pins that nearly touch would make the drawing of pins far apart so
// large that its discs cannot be seen. So a drawing of listed positions is at most `most` times `pitch` wide and high.
export function scale(pitch, most) {
  const extent = (axis) => {
    const places = known.positions_mm.map((place) => place[axis]);
    return Math.max(...places) - Math.min(...places);
  };
  const pitches = Math.max(extent(0), extent(1)) / known.pitch_mm;
  const shrink = known.grid ? 1 : Math.min(1, most / pitches);
  return (shrink * pitch) / known.pitch_mm;
}

// The pins as a drawing has them, y downwards, with `unit` drawing units per mm: the pins' places, the smallest box around the places
// (left, top, width, height), and the radius of a pin's tip.
export function layout(unit) {
  const places = known.positions_mm.map(([x, y]) => [unit * x, -unit * y]);
  const [across, down] = [0, 1].map((axis) => places.map((place) => place[axis]));
  const [left, top] = [Math.min(...across), Math.min(...down)];
  return { places, box: [left, top, Math.max(...across) - left, Math.max(...down) - top], radius: unit * known.pin_radius_mm };
}
