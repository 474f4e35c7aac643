// What a person draws, as the daemon takes it: an object (`docs/reference/object.md`). And how the pad shows it. `doc`: the drawing, see `designer.js`. Lengths are in mm, places from the array's middle, y towards the fingertip.

import { array } from "./array.js";
import { make } from "./pins.js";
import { isOnPad } from "./pad.js";

const BRAILLE = "⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚⠅⠇⠍⠝⠕⠏⠟⠗⠎⠞⠥⠧⠺⠭⠽⠵";
// The name of a drawing, until its pattern is stored under another one.
const NAME = "drawn";
// Cells of Braille in print are this many distances of dots apart.
const CELL = 6.2 / 2.34;
// How far the drawing of an edge reaches.
const FAR = 40;

const round = (mm) => Math.round(mm * 1000) / 1000;
const middle = ([a, b]) => [round((a[0] + b[0]) / 2), round((a[1] + b[1]) / 2)];
const angle = ([a, b]) => round((Math.atan2(b[1] - a[1], b[0] - a[0]) * 180) / Math.PI);
const apart = ([a, b]) => Math.hypot(b[0] - a[0], b[1] - a[1]);

// The places of a thing's own frame on the pad.
function placed([x, y], degrees, places) {
  const [c, s] = [Math.cos((degrees * Math.PI) / 180), Math.sin((degrees * Math.PI) / 180)];
  return places.map(([u, v]) => [x + c * u - s * v, y + s * u + c * v]);
}

// The dots of a Braille text, its middle at the origin.
function braille(text, pitch) {
  return [...text].flatMap((letter, i) => {
    const code = letter.codePointAt(0);
    const bits = (code >= 0x2800 && code <= 0x283f ? code : BRAILLE.codePointAt(code - 97) ?? 0x2800) - 0x2800;
    const x = (i - (text.length - 1) / 2) * CELL * pitch;
    return [0, 1, 2, 3, 4, 5].filter((dot) => (bits >> dot) & 1).map((dot) => [x + (Math.floor(dot / 3) - 0.5) * pitch, (1 - (dot % 3)) * pitch]);
  });
}

const points = (doc) => doc.lines.flat();
const ends = (doc) => (points(doc).length > 1 && apart(points(doc)) > 0 ? points(doc).slice(0, 2) : null);

function touch({ touch, numbers: of }) {
  if (touch === "scan") return { scan: { depth_um: of.depth, speed_mm_s: of.speed, direction_deg: of.direction, distance_mm: of.distance } };
  return { press: { depth_um: of.depth, rise_s: of.rise / 1000, hold_s: of.hold / 1000, fall_s: of.fall / 1000 } };
}

// The keys of the thing's shape; null if it is not complete.
function shape(doc) {
  const { numbers: of, at } = doc;
  const two = ends(doc);
  switch (doc.shape) {
    case "edge": return two && { shape: "edge", center_mm: middle(two), angle_deg: angle(two) };
    case "bar": return two && apart(two) >= 0.1 ? { shape: "bar", length_mm: round(apart(two)), width_mm: of.width, center_mm: middle(two), angle_deg: angle(two) } : null;
    case "polyline": return points(doc).length ? { shape: "lines", lines: doc.lines, width_mm: of.width } : null;
    case "dots": return points(doc).length ? { shape: "dots", points: points(doc), diameter_mm: of.diameter } : null;
    case "braille": return doc.text.trim() ? { shape: "braille", text: doc.text, dot_pitch_mm: of.pitch, diameter_mm: of.diameter, center_mm: at, angle_deg: of.angle } : null;
    case "heightmap": return doc.picture && {
      shape: "heightmap", file: doc.picture.name, mm_per_pixel: of.mm, um_per_level: of.white / doc.picture.levels, center_mm: at, angle_deg: of.angle,
    };
    default: return null;
  }
}

// The request that renders the thing; null if it is not complete.
export function rendering(doc) {
  const keys = shape(doc);
  if (!keys || !array()) return null;
  const files = doc.shape === "heightmap" ? { files: { [doc.picture.name]: doc.picture.data } } : {};
  return { object: { kind: "object", name: NAME, ...keys, touch: touch(doc) }, method: doc.method, ...files };
}

// The object of a live play: null, and why there is none.
export function live(doc) {
  if (doc.shape === "heightmap") return [null, "A height map cannot move live: its contact takes too long to compute."];
  const keys = shape(doc);
  return [keys && { kind: "object", name: NAME, ...keys, touch: { press: { depth_um: doc.numbers.depth } } }, ""];
}

const dot = ([cx, y], diameter) => make("circle", { cx, cy: -y, r: diameter / 2, class: "shape-dot" });
const path = (places, more) => make("path", { d: `M${places.map(([x, y]) => `${x} ${-y}`).join("L")}`, ...more });

function cells({ picture, numbers: of, at }) {
  const [wide, high] = picture.size.map((pixels) => pixels * of.mm);
  const group = make("g", { transform: `translate(${at[0]} ${-at[1]}) rotate(${-of.angle})` });
  if (picture.cells) {
    const { columns, rows, grey } = picture.cells;
    const [w, h] = [wide / columns, high / rows];
    group.append(...grey.map((level, i) => make("rect", { x: -wide / 2 + (i % columns) * w, y: -high / 2 + Math.floor(i / columns) * h, width: w * 1.02, height: h * 1.02, class: "cell", "fill-opacity": (level / 255).toFixed(2) })));
  }
  group.append(make("rect", { x: -wide / 2, y: -high / 2, width: wide, height: high, class: "frame" }));
  return [group];
}

// The thing on the pad, in its size.
export function drawn(doc) {
  const { numbers: of } = doc;
  const handles = () => points(doc).map((place) => make("circle", { cx: place[0], cy: -place[1], r: 0.3, class: "handle" }));
  const two = ends(doc);
  switch (doc.shape) {
    case "edge": {
      if (!two) return handles();
      const half = placed(middle(two), angle(two), [[-FAR, 0], [FAR, 0], [FAR, -FAR], [-FAR, -FAR]]);
      return [path(half, { class: "half" }), path(two, { class: "shape-line" }), ...handles()];
    }
    case "bar": {
      if (!two) return handles();
      const [l, w] = [apart(two) / 2, of.width / 2];
      return [path([...placed(middle(two), angle(two), [[-l, -w], [l, -w], [l, w], [-l, w]])], { class: "solid" }), ...handles()];
    }
    case "polyline": return [...doc.lines.filter((places) => places.length).map((places) => (places.length === 1 ? dot(places[0], of.width) : path(places, { class: "stroke", "stroke-width": of.width }))), ...handles()];
    case "dots": return points(doc).map((place) => dot(place, of.diameter));
    case "braille": return placed(doc.at, of.angle, braille(doc.text, of.pitch)).map((place) => dot(place, of.diameter));
    case "heightmap": return doc.picture ? cells(doc) : [];
    default: return [];
  }
}

// What is off the pad or off the pins, in a sentence; empty if nothing is.
export function off(doc) {
  if (!array()) return "";
  const { positions_mm: pins, pitch_mm: pitch } = array();
  const [places, what] = { braille: [placed(doc.at, doc.numbers.angle, braille(doc.text, doc.numbers.pitch)), "dots"] }[doc.shape] ?? [points(doc), "points"];
  if (doc.shape === "heightmap" || !places.length) return "";
  const said = [];
  const outside = places.filter((place) => !isOnPad(place)).length;
  if (outside) said.push(`${outside} of ${places.length} ${what} ${outside === 1 ? "lies" : "lie"} off the finger's pad.`);
  if (doc.shape === "edge") {
    const two = ends(doc);
    const side = ([x, y]) => (two[1][0] - two[0][0]) * (y - two[0][1]) - (two[1][1] - two[0][1]) * (x - two[0][0]) < 0;
    const covered = two ? pins.filter(side).length : 1;
    if (covered === 0 || covered === pins.length) said.push(`${covered ? "All pins lie" : "No pin lies"} under the edge's covered half: the pins cannot show where it ends.`);
    return said.join(" ");
  }
  const far = places.filter(([x, y]) => !pins.some((pin) => Math.hypot(x - pin[0], y - pin[1]) <= pitch)).length;
  if (far) said.push(`${far} of ${places.length} ${what} ${far === 1 ? "is" : "are"} off the pins, more than ${+pitch.toFixed(2)} mm from any.${doc.touch === "scan" ? "" : " A press cannot show what is there."}`);
  return said.join(" ");
}
