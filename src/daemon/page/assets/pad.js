// The pad on which a thing is drawn: with a pen, a mouse, or the keys. Places are in mm from the array's middle, y towards the fingertip.

import { array, layout } from "./array.js";
import { make } from "./pins.js";

// The pad of the simulated finger is an ellipse. Pins may stand outside of it.
export const [HALF_WIDTH, HALF_LENGTH] = [9, 12];
const MOST_POINTS = 200;
// A drawn line keeps as many points as it needs to be nowhere further from the pen's way, mm.
const NEAR = 0.05;
export const TOO_MANY = `That is not in the drawing: it has at most ${MOST_POINTS} points.`;
// Further from the middle no thing can lie, mm.
const MOST_MM = 100;
// A pen that moves less is still; a click this near to a dot takes it away.
const STEP = 1;
// The pen's way has a point at each of these steps.
const FINE = 0.1;
export const KEY_STEP = 0.5;
export const FINE_STEP = 0.1;
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
// What is drawn: two ends, lines, points, or the place of the thing's middle.
const MODES = { edge: "ends", bar: "ends", polyline: "lines", dots: "points", braille: "middle", heightmap: "middle" };

const round = (mm) => Math.round(mm * 100) / 100;
const apart = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
const within = (value, least, most) => Math.min(most, Math.max(least, value));

// How far a place is from the middle; 1 is the pad's border.
const distance = ([x, y]) => Math.hypot(x / HALF_WIDTH, y / HALF_LENGTH);
export const isOnPad = (place) => distance(place) <= 1;

// The place itself, if it lies on the pad, or the nearest one in the direction of the middle.
const onPad = (place) => (isOnPad(place) ? place : place.map((mm) => round(mm / (1.0001 * distance(place)))));

// How far a place is from the straight line between two others.
function off([x, y], [ax, ay], [bx, by]) {
  const long = (bx - ax) ** 2 + (by - ay) ** 2;
  const along = long && within(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / long, 0, 1);
  return Math.hypot(x - ax - along * (bx - ax), y - ay - along * (by - ay));
}

// The points of a line that it needs (Douglas and Peucker 1973).
export function simplified(places) {
  if (places.length < 3) return places;
  const away = places.map((place) => off(place, places[0], places.at(-1)));
  const far = away.indexOf(Math.max(...away));
  return away[far] <= NEAR ? [places[0], places.at(-1)] : [...simplified(places.slice(0, far + 1)).slice(0, -1), ...simplified(places.slice(far))];
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

// The box of a drawing of the pad: left, top, width and height in mm. It grows if pins stand outside of the pad.
export function frame() {
  const { box: [left, top, width, height], radius } = layout(1);
  const [x, y] = [Math.min(left - radius, -HALF_WIDTH) - 1, Math.min(top - radius, -HALF_LENGTH) - 1];
  return [x, y, Math.max(left + width + radius, HALF_WIDTH) + 1 - x, Math.max(top + height + radius, HALF_LENGTH) + 1 - y];
}

// Draws the pins of the daemon's array on a drawing of the pad.
export function arrange(svg) {
  if (!array()) return;
  const { places, radius } = layout(1);
  svg.setAttribute("viewBox", frame().join(" "));
  svg.querySelector("g").replaceChildren(...places.map(([cx, cy]) => make("circle", { cx, cy, r: radius, class: "pin-place" })));
}

export class Pad {
  // What is drawn: lines of points, and the middle of what is not drawn point by point.
  lines = [];
  at = [0, 0];
  shape = "bar";
  // Whether the last point had no place.
  isFull = false;
  // A live play takes the pen and the keys.
  isTaken = false;
  #cursor = [0, 0];
  // Where the pen came down, what was drawn before, and whether the pen has moved since.
  #pen = null;
  #changed;
  #say;
  #thing = make("g");
  #cross = make("path", { class: "cursor", d: "M-1 0H1M0 -1V1" });

  // `changed`: called with `move` while the pen draws, with `pen` when it has left the pad, and with `key`. `say`: announces a line to
  // screen readers.
  constructor(place, changed, say) {
    [this.#changed, this.#say] = [changed, say];
    this.svg = drawing("");
    this.svg.append(this.#thing, this.#cross);
    for (const [name, value] of [["role", "application"], ["tabindex", "0"], ["aria-label", "Pad to draw on"], ["aria-describedby", "pad-help"]]) this.svg.setAttribute(name, value);
    this.svg.addEventListener("pointerdown", (event) => this.#press(event));
    this.svg.addEventListener("pointermove", (event) => this.#pen && this.#move(this.#place(event)));
    this.svg.addEventListener("pointerup", (event) => this.#lift(event));
    this.svg.addEventListener("pointercancel", () => (this.#pen = null));
    this.svg.addEventListener("keydown", (event) => this.#key(event));
    place.append(this.svg);
    document.addEventListener("array", () => arrange(this.svg));
  }

  get points() {
    return this.lines.flat();
  }

  get isDrawn() {
    return MODES[this.shape] !== "middle" && this.shape in MODES;
  }

  // Shows the thing, as elements of SVG.
  show(thing) {
    this.#thing.replaceChildren(...thing);
    this.#thing.toggleAttribute("hidden", this.isTaken);
    this.#cross.setAttribute("transform", `translate(${this.#cursor[0]} ${-this.#cursor[1]})`);
  }

  // Sets what is drawn, in full; returns false, and changes nothing, if it has too many points.
  set(lines) {
    const all = lines.filter((places) => places.length).map((places) => places.map((place) => place.map((mm) => round(within(mm, -MOST_MM, MOST_MM)))));
    if (all.flat().length > MOST_POINTS) return false;
    this.lines = all;
    return true;
  }

  // As `set`; `isFull` says that it was refused.
  #draw(lines) {
    this.isFull = !this.set(lines);
    if (this.isFull) this.#say(TOO_MANY);
  }

  // The place of the pen within the drawing.
  #place(event) {
    const { x, y, width, height } = this.svg.viewBox.baseVal;
    const [across, up] = penAt(this.svg, event);
    return [round(within(across, x, x + width)), round(within(up, -y - height, -y))];
  }

  #press(event) {
    if (this.isTaken || !(this.shape in MODES) || event.button > 0) return;
    event.preventDefault();
    this.svg.focus({ focusVisible: false });
    this.svg.setPointerCapture(event.pointerId);
    const down = this.#place(event);
    this.#pen = { down, before: this.lines, at: this.at, hasMoved: false, way: [down] };
    if (MODES[this.shape] !== "middle") this.#add(down);
    this.#changed("move");
  }

  // Adds a point of the pen or of the keys. A complete edge or bar begins again, and an existing dot is removed.
  #add(at) {
    this.#cursor = at;
    const { points } = this;
    const mode = MODES[this.shape];
    if (mode === "points") {
      const rest = points.filter((point) => apart(point, at) >= STEP);
      this.#draw([rest.length < points.length ? rest : [...points, at]]);
    } else if (mode === "ends") {
      this.#draw([points.length === 1 ? [...points, at] : [at]]);
    } else {
      this.#draw([...this.lines.slice(0, -1), [...(this.lines.at(-1) ?? []), at]]);
    }
  }

  #move(at) {
    const { down, before, hasMoved, way } = this.#pen;
    const mode = MODES[this.shape];
    if (mode === "points" || (!hasMoved && apart(down, at) < (mode === "middle" ? FINE_STEP : STEP))) return;
    this.#pen.hasMoved = true;
    if (mode === "ends") this.#draw([[down, at]]);
    else if (mode === "middle") this.at = [0, 1].map((axis) => round(this.#pen.at[axis] + at[axis] - down[axis]));
    // A drawn stroke is a line of its own; a click goes on with the last one.
    else if (apart(way.at(-1), at) >= FINE) {
      way.push(at);
      this.#draw([...before, simplified(way)]);
    }
    this.#changed("move");
  }

  #lift(event) {
    if (!this.#pen) return;
    this.#move(this.#place(event));
    this.#pen = null;
    this.#changed("pen");
  }

  // Takes the last point away.
  #back() {
    this.#draw([...this.lines.slice(0, -1), (this.lines.at(-1) ?? []).slice(0, -1)]);
    this.#say(`${this.points.length} points are left.`);
  }

  #key(event) {
    if (this.isTaken || !(this.shape in MODES) || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = KEYS[event.key];
    if (step) {
      const mm = event.shiftKey ? FINE_STEP : KEY_STEP;
      const from = this.isDrawn ? this.#cursor : this.at;
      const to = [0, 1].map((axis) => round(within(from[axis] + mm * step[axis], -MOST_MM, MOST_MM)));
      this.#cursor = onPad(to);
      if (!this.isDrawn) this.#cursor = this.at = to;
      this.#changed(this.isDrawn ? "move" : "key");
      this.#say(`${this.#cursor[0]}, ${this.#cursor[1]} mm`);
    } else if (this.isDrawn && (event.key === "Enter" || event.key === " ")) {
      this.#add(this.#cursor);
      this.#changed("key");
      this.#say(`${this.points.length} points, the last at ${this.#cursor[0]}, ${this.#cursor[1]} mm.`);
    } else if (this.shape === "polyline" && event.key.toLowerCase() === "n") {
      // The next point begins another line.
      this.#draw([...this.lines, [this.#cursor]]);
      this.#changed("key");
      this.#say(`Line ${this.lines.length} begins at ${this.#cursor[0]}, ${this.#cursor[1]} mm.`);
    } else if (this.isDrawn && (event.key === "Backspace" || event.key === "Delete")) {
      this.#back();
      this.#changed("key");
    } else {
      return;
    }
    event.preventDefault();
  }
}
