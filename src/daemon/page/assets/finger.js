// The fingertip with its pins, as an SVG. Beside a pin stands its number. Its colour and size show its highest point in the 0.2 s that a
// status tells of, whether it moves or stands, the text below the frequency or that height, and a bar the offset from rest.

import { layout, scale } from "./array.js";
import { write } from "./control.js";
import { SENSOR_FAULTS } from "./words.js";

// Drawing units: from a pin to its nearest neighbour, and from the outermost pins to the edge of the skin. What stands at a pin fits.
const PITCH = 29;
// A drawing of listed positions is at most this many times as wide and high.
const MOST_PITCHES = 12;
const EDGE = 24;
// The radius of a pin's disc, at least: of pins that are small beside their distances.
const LEAST_RADIUS = 3;
// The radius of the skin's corners, at most: pins in the corners stay on the skin.
const CORNER = 58;
export const FULL_UM = 100;
// A pin that moves by less is drawn as still, and one that stands lower as at rest, µm.
const LEAST_UM = 0.5;
// A lower figure of a status comes of one press, one turn or part of a stroke: two strokes in 0.2 s are a frequency.
const LEAST_HZ = 8;
// Stops of a colour map that rises in lightness, so that it is readable without colours.
const COLOURS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

export function make(name, attributes = {}, text = "") {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text) element.textContent = text;
  return element;
}

// The colours, from 0 to `FULL_UM`, as CSS has them.
export const gradient = () => `linear-gradient(90deg, ${COLOURS.map((colour) => `rgb(${colour.join(" ")})`).join(", ")})`;

export function colour(um) {
  const at = (Math.min(Math.max(um / FULL_UM, 0), 1) * (COLOURS.length - 1)) || 0;
  const low = Math.min(Math.floor(at), COLOURS.length - 2);
  const mix = COLOURS[low].map((from, i) => Math.round(from + (COLOURS[low + 1][i] - from) * (at - low)));
  return `rgb(${mix.join(" ")})`;
}

// The highest point of a pin, µm above rest. `now`: its movement, as the status has it.
export const highest = ({ height_um: middle, swing_um: swing }) => middle + swing / 2;

const isMoving = (now) => now.swing_um >= LEAST_UM;
const hertz = ({ swing_um: swing, hz }) => (swing >= LEAST_UM && hz >= LEAST_HZ ? `${+hz.toFixed(1)} Hz` : "");

// A pin's movement in words; `now` is null if it is not known.
export function movement(now) {
  if (!now) return "not known";
  if (!isMoving(now)) return highest(now) >= LEAST_UM ? "stands" : "still";
  return `${(now.height_um - now.swing_um / 2).toFixed(0)} to ${highest(now).toFixed(0)} µm${hertz(now) && ` at ${hertz(now)}`}`;
}

// A small map of the amplitudes that a pattern for the daemon's array reaches, over its whole length, and of the pins that have motions.
// `drives`: `motor` and `reached_um`. `pattern`: its keys.
export function thumbnail({ drives, pattern = {} }) {
  const { places, box: [left, top, width, height] } = layout(scale(10, 6));
  const svg = make("svg", { viewBox: `${left - 5} ${top - 5} ${width + 10} ${height + 10}`, class: "thumbnail", role: "img" });
  const most = places.map(() => 0);
  for (const { motor, reached_um: um } of drives) if (motor in most) most[motor] = Math.max(most[motor], um);
  const follows = new Set(["wave", "ramp", "tone", "noise"].flatMap((key) => pattern[key] ?? []).map((motion) => motion.motor));
  const moving = places.flatMap((_, motor) => (most[motor] > 0 || follows.has(motor) ? [motor] : []));
  svg.setAttribute("aria-label", `Pins that move: ${moving.join(", ") || "none"}`);
  places.forEach(([cx, cy], motor) => {
    const um = most[motor];
    const look = um > 0 ? { r: 2 + (2.5 * Math.min(um, FULL_UM)) / FULL_UM, fill: colour(um), class: "dot" }
      : follows.has(motor) ? { r: 2.5, class: "dot follows" } : { r: 1.2, class: "dot still" };
    svg.append(make("circle", { cx, cy, ...look }));
  });
  return svg;
}

export class Finger {
  #pins = [];
  #radius = 0;

  // Without pins until the array is known. The document gets the event `pin` when a person clicks on a pin, with its number.
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
    this.#pins = places.map(([x, y], motor) => {
      const group = make("g", { transform: `translate(${EDGE + x - left} ${EDGE + y - top})` });
      const pin = {
        group,
        disc: make("circle", { class: "pin" }),
        ring: make("circle", { r: 12, class: "sensor-fault" }),
        offset: make("rect", { class: "offset", x: -13.5, y: 0, width: 2, height: 0 }),
        mark: make("text", { class: "mark-text", y: 19 }),
        number: make("text", { class: "number", x: 12, y: 12 }, String(motor)),
        title: make("title"),
      };
      group.addEventListener("click", () => document.dispatchEvent(new CustomEvent("pin", { detail: motor })));
      group.append(pin.title, pin.ring, pin.offset, pin.disc, pin.mark, pin.number);
      this.svg.append(group);
      return pin;
    });
  }

  // Marks a pin.
  choose(motor) {
    this.#pins.forEach(({ group }, i) => group.classList.toggle("chosen", i === motor));
  }

  // `now`: what each pin does, as the status has it, null for a pin of which that is not known. `rest_um`: offsets. `faults`: sensor faults,
  // null for none.
  draw(now, rest_um, faults) {
    const known = this.#pins.map((_, motor) => now[motor] ?? null);
    set(this.svg, "aria-label", summary(known, rest_um));
    this.#pins.forEach((pin, motor) => {
      const does = known[motor];
      const rest = rest_um[motor] ?? 0;
      const um = does && highest(does) >= LEAST_UM ? highest(does) : 0;
      pin.group.classList.toggle("pin-unknown", !does);
      set(pin.disc, "r", um ? this.#radius + (5 * Math.min(um, FULL_UM)) / FULL_UM : 0.7 * this.#radius);
      set(pin.disc, "fill", um ? colour(um) : "none");
      set(pin.ring, "visibility", faults[motor] ? "visible" : "hidden");
      const bar = Math.min(Math.abs(rest) / 5, 12);
      set(pin.offset, "height", bar.toFixed(1));
      set(pin.offset, "y", (rest > 0 ? -bar : 0).toFixed(1));
      write(pin.mark, !does ? "?" : um ? hertz(does) || `${um.toFixed(0)} µm` : "");
      write(pin.title, `Pin ${motor}: ${movement(does)}${does ? `, up to ${um.toFixed(0)} µm, ${rest.toFixed(1)} µm from rest` : ""}${faults[motor] ? `, sensor fault: ${SENSOR_FAULTS[faults[motor]] ?? faults[motor]}` : ""}`);
    });
  }
}

// What all pins do, in words. `known`: as `draw` takes it.
function summary(known, rest_um) {
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

function set(element, name, value) {
  const text = String(value);
  if (element.getAttribute(name) !== text) element.setAttribute(name, text);
}

function outline(width, height) {
  const r = Math.min(width / 2 - 2, height - 4, CORNER);
  return `M2 ${height - 2} V${r + 2} A${r} ${r} 0 0 1 ${r + 2} 2 H${width - r - 2} A${r} ${r} 0 0 1 ${width - 2} ${r + 2} V${height - 2} Z`;
}
