// A finger under the real thing and under the display: maps of its afferents by class, their spikes over time, and the figures that say
// how near they come. Each afferent is a dot; a prediction is not a sensation.

import { element } from "./control.js";
import { colour, make } from "./finger.js";
import { drawing, line } from "./pad.js";

const CLASSES = ["SA1", "RA", "PC"];
const NAMES = { rule: "The plain press", "vibrate-60": "The vibration at 60 Hz" };
const SIDES = [["real_s", "Real thing"], ["found_s", "Display"]];
const MEASURES = [["r_by_class", "r", 1], ["error_by_class", "error", -1]];
// The raster's units: its width, the room for the names of the classes, and the height of each class.
const [WIDTH, LEFT] = [400, 34];
const BANDS = [60, 80, 40];

// A number that is not defined is a dash.
const dash = (value) => value?.toFixed(2) ?? "–";
const of = (response, kind) => response.class.flatMap((name, i) => (name === kind ? [i] : []));
const count = (spikes, which) => which.reduce((sum, i) => sum + spikes[i].length, 0);

// `rates`: of the afferents at `places`; the largest of all maps is `most`. `outline`: lines that draw the shape.
function map(title, text, places, rates, most, outline) {
  const svg = drawing(`${title}: ${text}`);
  places.forEach(([x, y], i) => {
    const share = rates[i] / most;
    svg.append(make("circle", { cx: x, cy: -y, r: (0.14 + 0.24 * share).toFixed(2), ...(share > 0 ? { fill: colour(100 * share), class: "dot" } : { class: "dot still" }) }));
  });
  const lines = make("g", { class: "over" });
  lines.append(...outline.map(line));
  svg.append(lines);
  const figure = document.createElement("figure");
  const caption = document.createElement("figcaption");
  caption.append(element("strong", title), element("span", text));
  figure.append(svg, caption);
  return figure;
}

// The maps: for each class the real thing and the display beside each other, with one scale of colours.
export function responses({ response, outline }) {
  return CLASSES.map((kind) => {
    const which = of(response, kind);
    const places = which.map((i) => response.places_mm[i]);
    const rates = SIDES.map(([key]) => which.map((i) => response[key][i].length / response.seconds));
    const most = Math.max(1, ...rates.flat());
    const block = element("div", "", { className: "pair" });
    const title = element("h4", kind);
    title.append(element("span", `, up to ${most.toFixed(0)} impulses/s`));
    block.append(title, ...SIDES.map(([key, name], side) => map(name, `${count(response[key], which)} spikes`, places, rates[side], most, outline)));
    return block;
  });
}

// The rasters: a mark for each spike, and a row for each afferent that fires on either side, by class and by its place along the finger.
export function rasters({ response }) {
  const { places_mm: places, seconds } = response;
  const ordered = CLASSES.map((kind) => of(response, kind).filter((i) => SIDES.some(([key]) => response[key][i].length)).sort((a, b) => places[b][1] - places[a][1]));
  const bottom = BANDS.reduce((sum, height) => sum + height + 8, 4);
  return SIDES.map(([key, name]) => {
    const counts = CLASSES.map((kind, k) => `${kind} ${count(response[key], ordered[k])}`).join(", ");
    const svg = make("svg", { viewBox: `0 0 ${WIDTH} ${bottom + 12}`, class: "raster", role: "img", "aria-label": `${name}, spikes over ${seconds.toFixed(2)} s: ${counts}` });
    let top = 4;
    ordered.forEach((which, k) => {
      const row = BANDS[k] / Math.max(1, which.length);
      const length = Math.max(2, Math.min(row, 6)).toFixed(1);
      const marks = which.flatMap((i, at) => {
        // Spikes nearer than a unit of the drawing are one mark.
        const spikes = new Set(response[key][i].map((s) => Math.round(LEFT + (s / seconds) * (WIDTH - LEFT - 4))));
        return [...spikes].map((x) => `M${x} ${(top + row * at).toFixed(1)}v${length}`);
      });
      svg.append(make("text", { x: 2, y: top + BANDS[k] / 2 + 4 }, CLASSES[k]), make("path", { d: marks.join(""), class: `spikes ${CLASSES[k]}` }));
      top += BANDS[k] + 4;
      svg.append(make("line", { x1: LEFT, x2: WIDTH - 4, y1: top, y2: top, class: "grid" }));
      top += 4;
    });
    svg.append(make("text", { x: LEFT, y: bottom + 8 }, "0"), make("text", { x: WIDTH - 4, y: bottom + 8, "text-anchor": "end" }, `${seconds.toFixed(2)} s`));
    const figure = element("figure");
    const caption = element("figcaption");
    caption.append(element("strong", `${name}, spikes over time`));
    figure.append(caption, svg);
    return figure;
  });
}

// In how many measures a pattern is nearer to the thing than another one, where it gains most, and in which it is further: both numbers,
// its own first.
function against(found, other, name) {
  const parts = MEASURES.flatMap(([key, measure, sign]) => CLASSES.map((kind, k) => {
    const [a, b] = [found[key][k], other[key][k]].map((value) => (value === null ? NaN : Number(value.toFixed(2))));
    return { text: `${measure} of ${kind} ${a.toFixed(2)} (${b.toFixed(2)})`, by: sign * (a - b) };
  })).filter(({ by }) => !Number.isNaN(by));
  const nearer = parts.filter(({ by }) => by > 0).sort((a, b) => b.by - a.by);
  const further = parts.filter(({ by }) => by < 0).map(({ text }) => text);
  const most = nearer.length ? `, most by ${nearer[0].text}` : "";
  return `Nearer to the thing than ${name} in ${nearer.length} of ${parts.length} measures${most}.${further.length ? ` Further by ${further.join(", ")}.` : ""}`;
}

// Lines that say whether the found pattern is worth it. `judged`: the found pattern, and those that it has to beat.
export function verdict([found, ...others]) {
  const rivals = others.filter((other) => other.name !== found.name);
  return rivals.map((other) => against(found, other, NAMES[other.name].replace("The", "the")));
}

// The columns of the table, with how far a number is from that of the thing itself.
const COLUMNS = [["r_by_class", (r) => 1 - r], ["error_by_class", (error) => error], ["spikes", (share) => Math.abs(Math.log(share))]];

// Rows for the table of figures. The best number of a column is bold.
export function rows([found, ...others]) {
  const all = [found, ...others];
  const cells = all.map(() => []);
  for (const [key, away] of COLUMNS) {
    CLASSES.forEach((_, k) => {
      const texts = all.map((judged) => dash(judged[key][k]));
      const distances = texts.map((text) => (text === "–" ? Infinity : away(Number(text))));
      const best = Math.min(...distances);
      texts.forEach((text, i) => {
        const cell = element("td", "");
        cell.append(distances[i] === best && best < Infinity ? element("strong", text) : text);
        cells[i].push(cell);
      });
    });
  }
  return all.map((judged, i) => {
    const row = element("tr");
    row.append(element("th", i === 0 ? `Found (${judged.name})` : NAMES[judged.name], { scope: "row" }), ...cells[i]);
    return row;
  });
}
