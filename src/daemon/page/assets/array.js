// The array that the daemon drives: its pins, its motors, its name. The document gets the event `array` when the array is known, and
// when the daemon drives another one.

import { call } from "./api.js";

let known = null;

// As `GET /v1/array` shows it; null until it is known.
export const array = () => known;

export async function loadArray() {
  const found = await call("GET", "/v1/array");
  if (found.hash === known?.hash) return;
  known = found;
  document.dispatchEvent(new Event("array"));
}

// The pins as a drawing has them, y downwards, with this many units between neighbours: the pins' places, the smallest box around the
// places (left, top, width, height), and the radius of a pin's tip.
export function layout(pitch) {
  const unit = pitch / known.pitch_mm;
  const places = known.positions_mm.map(([x, y]) => [unit * x, -unit * y]);
  const [across, down] = [0, 1].map((axis) => places.map((place) => place[axis]));
  const [left, top] = [Math.min(...across), Math.min(...down)];
  return { places, box: [left, top, Math.max(...across) - left, Math.max(...down) - top], radius: unit * known.pin_radius_mm };
}
