// The pad on which a target is drawn: with a pen, a mouse, or the keys. Places are in mm from the array's middle, y towards the fingertip.

import { array, layout } from "./array.js";
import { make } from "./finger.js";

// The pad of the simulated finger is an ellipse; the daemon refuses points outside of it. Pins may stand outside.
export const [HALF_WIDTH, HALF_LENGTH] = [9, 12];
const MOST_POINTS = 64;
// A line that is drawn freely gets a point at each of these steps; a click this near to a dot takes it away.
const STEP = 1;
export const KEY_STEP = 0.5;
export const FINE_STEP = 0.1;
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
const MOST = { segment: 2, polyline: MOST_POINTS, dots: MOST_POINTS };

const round = (mm) => Math.round(mm * 100) / 100;
const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

// The nearest place on the pad in the direction of the middle.
export function onPad([x, y]) {
  const far = Math.max(1, Math.hypot(x / HALF_WIDTH, y / HALF_LENGTH) * 1.0001);
  return [round(x / far), round(y / far)];
}

// The place of the pen on a drawing of the pad, also beyond its border.
export function penAt(svg, event) {
  const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  return [at.x, -at.y];
}

// The line of a shape through some places; a single place is a dot.
export function line(places) {
  return places.length === 1
    ? make("circle", { cx: places[0][0], cy: -places[0][1], r: 0.55, class: "shape-dot" })
    : make("polyline", { points: places.map(([x, y]) => `${x},${-y}`).join(" "), class: "shape-line" });
}

// The pad with its pins, without a shape.
export function drawing(label) {
  const svg = make("svg", { role: "img", "aria-label": label, class: "pad" });
  svg.append(make("ellipse", { rx: HALF_WIDTH, ry: HALF_LENGTH, class: "skin" }), make("g"));
  arrange(svg);
  return svg;
}

// Draws the pins of the daemon's array on a drawing of the pad, which grows if pins stand outside of the pad.
export function arrange(svg) {
  if (!array()) return;
  const { places, box: [left, top, width, height], radius } = layout(1);
  const [x, y] = [Math.min(left - radius, -HALF_WIDTH) - 1, Math.min(top - radius, -HALF_LENGTH) - 1];
  const [right, bottom] = [Math.max(left + width + radius, HALF_WIDTH) + 1, Math.max(top + height + radius, HALF_LENGTH) + 1];
  svg.setAttribute("viewBox", `${x} ${y} ${right - x} ${bottom - y}`);
  svg.querySelector("g").replaceChildren(...places.map(([cx, cy]) => make("circle", { cx, cy, r: radius, class: "pin-place" })));
}

export class Pad {
  points = [];
  mode = "segment";
  #cursor = [0, 0];
  #pressed = false;
  #changed;
  #lifted;
  #say;
  #shape = make("g");
  #cross = make("path", { class: "cursor", d: "M-1 0H1M0 -1V1" });

  // `changed`: called when the points have changed. `lifted`: called when the pen has left the pad. `say`: announces a line to
  // screen readers.
  constructor(place, changed, lifted, say) {
    [this.#changed, this.#lifted, this.#say] = [changed, lifted, say];
    this.svg = drawing("");
    this.svg.append(this.#shape, this.#cross);
    for (const [name, value] of [["role", "application"], ["tabindex", "0"], ["aria-label", "Pad to draw on"], ["aria-describedby", "pad-help"]]) this.svg.setAttribute(name, value);
    this.svg.addEventListener("pointerdown", (event) => this.#press(event));
    this.svg.addEventListener("pointermove", (event) => this.#pressed && this.#move(onPad(penAt(this.svg, event))));
    this.svg.addEventListener("pointerup", (event) => this.#lift(event));
    this.svg.addEventListener("pointercancel", () => (this.#pressed = false));
    this.svg.addEventListener("keydown", (event) => this.#key(event));
    place.append(this.svg);
    document.addEventListener("array", () => arrange(this.svg));
  }

  // Shows these lines, which cannot be drawn on, or the drawn points.
  show(outline) {
    const drawn = this.mode === "dots" ? this.points.map((point) => [point]) : [this.points, ...this.points.map((point) => [point])];
    const lines = outline ?? drawn.filter((places) => places.length);
    this.#shape.replaceChildren(...lines.map(line));
    this.#cross.setAttribute("transform", `translate(${this.#cursor[0]} ${-this.#cursor[1]})`);
  }

  set(points) {
    this.points = points.slice(0, MOST[this.mode] ?? MOST_POINTS).map(onPad);
    this.#changed();
  }

  undo() {
    this.set(this.points.slice(0, -1));
    this.#say(`${this.points.length} points are left.`);
  }

  #press(event) {
    if (!(this.mode in MOST) || event.button > 0) return;
    event.preventDefault();
    this.svg.focus({ focusVisible: false });
    this.svg.setPointerCapture(event.pointerId);
    this.#pressed = true;
    this.#add(onPad(penAt(this.svg, event)));
  }

  // Adds a point of the pen or of the keys. A complete edge begins again, and an existing dot is removed.
  #add(at) {
    this.#cursor = at;
    if (this.mode === "dots") {
      const rest = this.points.filter((point) => apart(point, at) >= STEP);
      this.set(rest.length < this.points.length ? rest : [...this.points, at]);
    } else {
      this.set([...(this.mode === "segment" && this.points.length > 1 ? [] : this.points), at]);
    }
  }

  #move(at) {
    const first = this.points[0];
    if (this.mode === "segment" && first && apart(first, at) >= STEP) this.set([first, at]);
    else if (this.mode === "polyline" && this.points.length && apart(this.points.at(-1), at) >= STEP) this.set([...this.points, at]);
  }

  #lift(event) {
    if (!this.#pressed) return;
    this.#move(onPad(penAt(this.svg, event)));
    this.#pressed = false;
    this.#lifted();
  }

  #key(event) {
    if (!(this.mode in MOST) || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = KEYS[event.key];
    if (step) {
      const mm = event.shiftKey ? FINE_STEP : KEY_STEP;
      this.#cursor = onPad([this.#cursor[0] + mm * step[0], this.#cursor[1] + mm * step[1]]);
      this.show();
      this.#say(`${this.#cursor[0]}, ${this.#cursor[1]} mm`);
    } else if (event.key === "Enter" || event.key === " ") {
      this.#add(this.#cursor);
      this.#say(`${this.points.length} points, the last at ${this.#cursor[0]}, ${this.#cursor[1]} mm.`);
    } else if (event.key === "Backspace" || event.key === "Delete") {
      this.undo();
    } else {
      return;
    }
    event.preventDefault();
  }
}
