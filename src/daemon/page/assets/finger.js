// The fingertip with its 24 pins, as an SVG. Colour and size of a pin show the amplitude that it reaches, a hand its phase, a number its
// frequency, a bar its offset from rest. Pins that move are drawn 20 times slower.

const ROWS = 6;
const COLUMNS = 4;
export const MOTORS = ROWS * COLUMNS;
const SLOWER = 20;
// Drawing units: one is a tenth of a millimetre. The pitch is 2.9 mm.
const PITCH = 29;
const EDGE = 24;
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

// A small map of the amplitudes that a pattern reaches, over its whole length.
export function thumbnail(details) {
  const svg = make("svg", { viewBox: "0 0 40 60", class: "thumbnail", role: "img" });
  const most = new Array(MOTORS).fill(0);
  for (const of of details.drives) most[of.motor] = Math.max(most[of.motor], of.reached_um);
  const moving = most.map((um, motor) => [motor, um]).filter(([, um]) => um > 0);
  svg.setAttribute("aria-label", `Pins that move: ${moving.map(([motor]) => motor).join(", ") || "none"}`);
  most.forEach((um, motor) => {
    const [x, y] = [5 + 10 * (motor % COLUMNS), 5 + 10 * Math.floor(motor / COLUMNS)];
    svg.append(make("circle", { cx: x, cy: y, r: um > 0 ? 2 + (2.5 * um) / FULL_UM : 1.2, fill: um > 0 ? colour(um) : "currentColor", opacity: um > 0 ? 1 : 0.3 }));
  });
  return svg;
}

export class Finger {
  #pins = [];
  #still = matchMedia("(prefers-reduced-motion: reduce)");

  constructor(place) {
    const [width, height] = [2 * EDGE + (COLUMNS - 1) * PITCH, 2 * EDGE + (ROWS - 1) * PITCH];
    this.svg = make("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", class: "finger" });
    this.svg.append(make("path", { class: "skin", d: outline(width, height) }));
    for (let motor = 0; motor < MOTORS; motor++) {
      // Row 0 is at the top, as in all maps of the project.
      const [x, y] = [EDGE + PITCH * (motor % COLUMNS), EDGE + PITCH * Math.floor(motor / COLUMNS)];
      const group = make("g", { transform: `translate(${x} ${y})` });
      const pin = {
        group,
        disc: make("circle", { r: 3, class: "pin" }),
        hand: make("line", { class: "hand", x1: 0, y1: 0, x2: 0, y2: -9 }),
        ring: make("circle", { r: 12, class: "doubt" }),
        offset: make("rect", { class: "offset", x: -13.5, y: 0, width: 2, height: 0 }),
        number: make("text", { class: "hertz", y: 19 }),
        title: make("title"),
      };
      group.append(pin.title, pin.ring, pin.offset, pin.disc, pin.hand, pin.number);
      this.svg.append(group);
      this.#pins.push(pin);
    }
    place.append(this.svg);
  }

  // `drives`: by motor; null if the pins' motion is not known, for the reason `why`. `rest_um`: offsets. `doubted`: motors.
  // `seconds`: since the onset.
  draw(drives, why, rest_um, doubted, seconds) {
    const moving = [...(drives?.values() ?? [])];
    const most = Math.max(0, ...rest_um.map(Math.abs));
    this.svg.classList.toggle("unknown", !drives);
    set(this.svg, "aria-label", !drives ? why : moving.length
      ? `${moving.length} of ${MOTORS} pins vibrate, up to ${Math.max(...moving.map((drive) => drive.reached_um)).toFixed(0)} µm`
      : `No pin vibrates. Largest offset from rest ${most.toFixed(0)} µm`);
    this.#pins.forEach((pin, motor) => {
      const drive = drives?.get(motor);
      const rest = rest_um[motor] ?? 0;
      const turns = drive && !this.#still.matches ? ((seconds * drive.frequency_hz) / SLOWER + drive.phase) % 1 : (drive?.phase ?? 0);
      const up = drive ? 0.5 - 0.5 * Math.cos(2 * Math.PI * turns) : 0;
      set(pin.disc, "r", drive ? (4 + (5 * drive.reached_um) / FULL_UM) * (this.#still.matches ? 1 : 0.75 + 0.25 * up) : 3);
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
  const r = width / 2 - 2;
  return `M2 ${height - 2} V${r + 2} A${r} ${r} 0 0 1 ${width - 2} ${r + 2} V${height - 2} Z`;
}
