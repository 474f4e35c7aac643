// The finger, seen from above: its pins rise from the skin, in height and colour. It shows the present, or a moment of what the pins did.
//
// Invariant: what is not known is hatched. `drawn` of the canvas holds the heights of the last frame, µm, null for a pin of which nothing is
// known.

import { known } from "./api.js";
import { array, layout } from "./array.js";
import { $, write } from "./control.js";
import { frame, HALF_LENGTH, HALF_WIDTH } from "./pad.js";
import { make, share, summary, tint } from "./pins.js";
import { SENSOR_FAULTS } from "./words.js";

// How far a pin at its full travel is lifted in the drawing, mm, at most, and as a part of the distance of pins.
const LIFT_MM = 1.6;
const LIFT = 0.55;
// The smallest radius of the place that takes a click, mm.
const CLICK_MM = 1.1;
const HATCH_MM = 1.2;
const COLOURS = ["--ink", "--soft", "--line", "--paper", "--accent", "--stop"];

export class Stage {
  #canvas = $("finger");
  #feed;
  #look = {};
  #asked = 0;
  // What is shown in place of the present: `{ take, ms, text }`, or null.
  #moment = null;
  #chosen = null;
  // What the last frame shows: one that shows the same is not drawn.
  #frame = "";
  #pins = make("svg", { class: "finger-pins", "aria-hidden": "true" });
  #calm = matchMedia("(prefers-reduced-motion: reduce)");

  // `feed`: what the pins do now. The document gets the event `pin` when a person clicks on a pin, with its number.
  constructor(feed) {
    this.#feed = feed;
    this.#canvas.after(this.#pins);
    document.addEventListener("array", () => this.#arrange());
    document.addEventListener("state", () => this.#refresh());
    new ResizeObserver(() => this.#refresh()).observe(this.#canvas);
    for (const query of ["(prefers-color-scheme: dark)", "(forced-colors: active)"]) matchMedia(query).addEventListener("change", () => this.#refresh(true));
  }

  // A place for each pin takes clicks, and has its number.
  #arrange() {
    const { places, radius } = layout(1);
    this.#frame = "";
    this.#pins.setAttribute("viewBox", frame().join(" "));
    this.#pins.replaceChildren(...places.map(([cx, cy], motor) => {
      const pin = make("g", { "data-motor": motor });
      pin.append(make("title", {}, `Pin ${motor}`), make("circle", { cx, cy, r: Math.max(radius, CLICK_MM) }), make("text", { class: "number", x: cx + radius + 0.1, y: cy + radius + 0.6 }, String(motor)));
      pin.addEventListener("click", () => document.dispatchEvent(new CustomEvent("pin", { detail: motor })));
      return pin;
    }));
    this.#refresh();
  }

  // Marks a pin.
  choose(motor) {
    this.#chosen = motor;
    [...this.#pins.children].forEach((pin, i) => pin.classList.toggle("chosen", i === motor));
    this.#refresh();
  }

  // Shows a moment of a take, or the present (null).
  show(moment) {
    this.#moment = moment;
    this.#refresh();
  }

  #refresh(isNew = false) {
    if (isNew) this.#look = {};
    this.#asked ||= requestAnimationFrame(() => {
      this.#asked = 0;
      if (!array()) return;
      this.#say();
      this.#draw();
      if (this.#feed.isRunning && !this.#moment && !this.#calm.matches) this.#refresh();
    });
  }

  // The colours of the page's scheme.
  #colour(name) {
    if (!this.#look[name]) {
      const style = getComputedStyle(document.documentElement);
      this.#look = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(name).trim()]));
    }
    return this.#look[name];
  }

  #draw() {
    const canvas = this.#canvas;
    const heights = this.#heights();
    canvas.drawn = heights;
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight].map((px) => Math.round(px * devicePixelRatio));
    const faults = this.#moment ? [] : (known()?.motors.map((motor) => motor.sensor_fault) ?? []);
    const shown = [wide, high, this.#chosen, this.#colour("--ink"), ...heights.map((um) => um?.toFixed(0)), ...faults].join();
    if (shown === this.#frame) return;
    this.#frame = shown;
    if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
    const [x, y, width, height] = frame();
    const scale = Math.min(wide / width, high / height);
    const context = canvas.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, wide, high);
    context.setTransform(scale, 0, 0, scale, (wide - scale * width) / 2 - scale * x, (high - scale * height) / 2 - scale * y);
    this.#drawSkin(context, heights.some((um) => um !== null));
    const { places, radius } = layout(1);
    const lift = Math.min(LIFT_MM, LIFT * array().pitch_mm);
    // Pins further down stand before those further up.
    const rows = places.map((_, motor) => motor).sort((a, b) => places[a][1] - places[b][1]);
    for (const motor of rows) {
      this.#drawPin(context, places[motor], radius, lift, heights[motor]);
      if (motor === this.#chosen) this.#ring(context, places[motor], radius + 0.35, "--accent", []);
      if (faults[motor]) this.#ring(context, places[motor], radius + 0.6, "--stop", [0.4, 0.25]);
    }
  }

  // The height of each pin that is shown.
  #heights() {
    const motors = array().positions_mm.map((_, motor) => motor);
    if (!this.#moment) {
      const now = this.#feed.now();
      return motors.map((motor) => now?.[motor] ?? null);
    }
    const { take, ms } = this.#moment;
    return motors.map((motor) => (motor < take.motors ? take.at(motor, Math.floor(ms), Math.floor(ms) + 1)[1] : null));
  }

  #drawSkin(context, isKnown) {
    context.beginPath();
    context.ellipse(0, 0, HALF_WIDTH, HALF_LENGTH, 0, 0, 2 * Math.PI);
    context.fillStyle = this.#colour("--paper");
    context.fill();
    [context.strokeStyle, context.lineWidth] = [this.#colour("--line"), 0.15];
    context.stroke();
    if (isKnown) return;
    context.save();
    context.clip();
    context.beginPath();
    for (let at = -3 * HALF_LENGTH; at < 3 * HALF_LENGTH; at += HATCH_MM) {
      context.moveTo(at - HALF_LENGTH, HALF_LENGTH);
      context.lineTo(at + HALF_LENGTH, -HALF_LENGTH);
    }
    context.lineWidth = 0.3;
    context.stroke();
    context.restore();
  }

  // A pin is a column that rises towards the top of the drawing. `um`: its height; null if it is not known.
  #drawPin(context, [x, y], radius, lift, um) {
    const rise = um === null ? 0 : share(um);
    const top = y - lift * rise;
    if (rise > 0) {
      // Its shadow, and its side.
      [context.globalAlpha, context.fillStyle] = [0.18, this.#colour("--ink")];
      context.beginPath();
      context.ellipse(x + 0.5 * lift * rise, y + 0.25 * lift * rise, radius * (1.1 + 0.5 * rise), radius * (1 + 0.3 * rise), 0, 0, 2 * Math.PI);
      context.fill();
      [context.globalAlpha, context.fillStyle] = [1, tint(0.75 * rise)];
      context.beginPath();
      context.arc(x, y, radius, 0, Math.PI);
      context.lineTo(x - radius, top);
      context.lineTo(x + radius, top);
      context.fill();
    }
    context.beginPath();
    context.arc(x, top, radius, 0, 2 * Math.PI);
    context.fillStyle = rise > 0 ? tint(rise) : this.#colour("--paper");
    context.fill();
    [context.strokeStyle, context.lineWidth] = [this.#colour(um === null ? "--soft" : "--ink"), 0.1];
    context.stroke();
  }

  #ring(context, [x, y], radius, colour, dashes) {
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    [context.strokeStyle, context.lineWidth] = [this.#colour(colour), 0.2];
    context.setLineDash(dashes);
    context.stroke();
    context.setLineDash([]);
  }

  // What the pins do, in words.
  #say() {
    const motors = known()?.motors ?? array().positions_mm.map(() => ({ now: null, rest_error_um: 0 }));
    const faulty = motors.flatMap(({ sensor_fault: fault }, motor) => (fault ? [`Sensor fault of pin ${motor}: ${SENSOR_FAULTS[fault] ?? fault}.`] : []));
    const text = [summary(motors.map(({ now }) => now), motors.map((motor) => motor.rest_error_um)), ...faulty].join(" ");
    if (this.#canvas.ariaLabel !== text) this.#canvas.ariaLabel = text;
    write($("finger-note"), this.#moment?.text ?? text);
  }
}
