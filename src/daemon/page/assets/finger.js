// The fingertip with its pins, as an SVG. Colour and size of a pin show the amplitude that it reaches, a hand its phase, a number its
// frequency, a bar its offset from rest. Pins that move are drawn 20 times slower.

import { layout, scale } from "./array.js";

const SLOWER = 20;
// Drawing units: from a pin to its nearest neighbour, and from the outermost pins to the edge of the skin. What stands at a pin fits.
const PITCH = 29;
// A drawing of listed positions is at most this many times as wide and high.
const MOST_PITCHES = 12;
const EDGE = 24;
// The radius of a pin's disc, at least: of pins that are small beside their distances.
const LEAST_RADIUS = 3;
// The radius of the skin's corners, at most: pins in the corners stay on the skin.
const CORNER = 58;
const FULL_UM = 100;
// Stops of a colour map that rises in lightness, so that it is readable without colours.
const COLOURS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

export function make(name, attributes = {}, text = "") {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text) element.textContent = text;
  return element;
}

export function colour(um) {
  const at = (Math.min(Math.max(um / FULL_UM, 0), 1) * (COLOURS.length - 1)) || 0;
  const low = Math.min(Math.floor(at), COLOURS.length - 2);
  const mix = COLOURS[low].map((from, i) => Math.round(from + (COLOURS[low + 1][i] - from) * (at - low)));
  return `rgb(${mix.join(" ")})`;
}

// The drives of a play that are on at `seconds` after its onset; the last one of a motor counts. `pattern`: in full. `reached`: what its
// drives reach in this play.
export function drivesAt({ pattern, reached: all }, seconds) {
  const now = new Map();
  const { drive: drives, duration_s: duration } = pattern;
  const t = duration ? seconds % duration : seconds;
  drives.forEach((drive, i) => {
    const on = t >= (drive.start_s ?? 0) && t < (drive.stop_s ?? Infinity);
    const reached = all.find((of) => of.drive === i + 1);
    if (on && reached?.reached_um > 0) now.set(drive.motor, { ...drive, reached_um: reached.reached_um });
  });
  return now;
}

// A small map of the amplitudes that a pattern for the daemon's array reaches, over its whole length.
export function thumbnail(details) {
  const { places, box: [left, top, width, height] } = layout(scale(10, 6));
  const svg = make("svg", { viewBox: `${left - 5} ${top - 5} ${width + 10} ${height + 10}`, class: "thumbnail", role: "img" });
  const most = places.map(() => 0);
  for (const of of details.drives) most[of.motor] = Math.max(most[of.motor], of.reached_um);
  const moving = most.map((um, motor) => [motor, um]).filter(([, um]) => um > 0);
  svg.setAttribute("aria-label", `Pins that move: ${moving.map(([motor]) => motor).join(", ") || "none"}`);
  most.forEach((um, motor) => {
    const [cx, cy] = places[motor];
    svg.append(make("circle", { cx, cy, r: um > 0 ? 2 + (2.5 * Math.min(um, FULL_UM)) / FULL_UM : 1.2, ...(um > 0 ? { fill: colour(um), class: "dot" } : { class: "dot still" }) }));
  });
  return svg;
}

export class Finger {
  #pins = [];
  #radius = 0;
  #still = matchMedia("(prefers-reduced-motion: reduce)");

  // Without pins until the array is known.
  constructor(place) {
    this.svg = make("svg", { role: "img", class: "finger" });
    place.append(this.svg);
    document.addEventListener("array", () => this.#arrange());
  }

  #arrange() {
    const { places, box: [left, top, wide, high], radius } = layout(scale(PITCH, MOST_PITCHES));
    const [width, height] = [2 * EDGE + wide, 2 * EDGE + high];
    this.#radius = Math.min(Math.max(radius, LEAST_RADIUS), PITCH / 4);
    set(this.svg, "viewBox", `0 0 ${width} ${height}`);
    this.svg.replaceChildren(make("path", { class: "skin", d: outline(width, height) }));
    this.#pins = places.map(([x, y]) => {
      const group = make("g", { transform: `translate(${EDGE + x - left} ${EDGE + y - top})` });
      const pin = {
        group,
        disc: make("circle", { class: "pin" }),
        hand: make("line", { class: "hand", x1: 0, y1: 0, x2: 0, y2: -9 }),
        ring: make("circle", { r: 12, class: "doubt" }),
        offset: make("rect", { class: "offset", x: -13.5, y: 0, width: 2, height: 0 }),
        number: make("text", { class: "hertz", y: 19 }),
        title: make("title"),
      };
      group.append(pin.title, pin.ring, pin.offset, pin.disc, pin.hand, pin.number);
      this.svg.append(group);
      return pin;
    });
  }

  // `drives`: by motor; null if the pins' motion is not known, for the reason `why`. `rest_um`: offsets. `doubted`: motors.
  // `seconds`: since the onset.
  draw(drives, why, rest_um, doubted, seconds) {
    const moving = [...(drives?.values() ?? [])];
    const most = Math.max(0, ...rest_um.map(Math.abs));
    this.svg.classList.toggle("unknown", !drives);
    set(this.svg, "aria-label", !drives ? why : moving.length
      ? `${moving.length} of ${this.#pins.length} pins vibrate, up to ${Math.max(...moving.map((drive) => drive.reached_um)).toFixed(0)} µm`
      : `No pin vibrates. Largest offset from rest ${most.toFixed(0)} µm`);
    this.#pins.forEach((pin, motor) => {
      const drive = drives?.get(motor);
      const rest = rest_um[motor] ?? 0;
      const turns = drive && !this.#still.matches ? ((seconds * drive.frequency_hz) / SLOWER + drive.phase) % 1 : (drive?.phase ?? 0);
      const up = drive ? 0.5 - 0.5 * Math.cos(2 * Math.PI * turns) : 0;
      set(pin.disc, "r", drive ? (this.#radius + (5 * Math.min(drive.reached_um, FULL_UM)) / FULL_UM) * (this.#still.matches ? 1 : 0.75 + 0.25 * up) : 0.7 * this.#radius);
      set(pin.disc, "fill", drive ? colour(drive.reached_um) : "none");
      set(pin.hand, "visibility", drive ? "visible" : "hidden");
      set(pin.hand, "transform", `rotate(${(360 * turns).toFixed(0)})`);
      set(pin.ring, "visibility", doubted.has(motor) ? "visible" : "hidden");
      const bar = Math.min(Math.abs(rest) / 5, 12);
      set(pin.offset, "height", bar.toFixed(1));
      set(pin.offset, "y", (rest > 0 ? -bar : 0).toFixed(1));
      const hertz = !drives ? "?" : drive ? `${+drive.frequency_hz.toFixed(0)} Hz` : "";
      if (pin.number.textContent !== hertz) pin.number.textContent = hertz;
      const text = !drives ? `Pin ${motor}: not known` : `Pin ${motor}: ${drive ? `${drive.reached_um.toFixed(0)} µm at ${drive.frequency_hz} Hz` : "still"}, ${rest.toFixed(1)} µm from rest${doubted.has(motor) ? ", its sensor is in doubt" : ""}`;
      if (pin.title.textContent !== text) pin.title.textContent = text;
    });
  }
}

function set(element, name, value) {
  const text = String(value);
  if (element.getAttribute(name) !== text) element.setAttribute(name, text);
}

function outline(width, height) {
  const r = Math.min(width / 2 - 2, height - 4, CORNER);
  return `M2 ${height - 2} V${r + 2} A${r} ${r} 0 0 1 ${r + 2} 2 H${width - r - 2} A${r} ${r} 0 0 1 ${width - 2} ${r + 2} V${height - 2} Z`;
}
