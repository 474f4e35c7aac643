// A finger under the real thing and under the display: maps of its afferents by class, their spikes over time, and the figures that say
// how near they come. Each afferent is a dot; a prediction is not a sensation.

import { element } from "./control.js";
import { make, tint } from "./pins.js";
import { drawing, line } from "./pad.js";
import { CLASSES, figure, ofClass, raster } from "./preview.js";

const NAMES = { rule: "The plain press", stroke: "One stroke as it passes", "vibrate-60": "The vibration at 60 Hz" };
const SIDES = [["real_s", "Real thing"], ["found_s", "Display"]];
// The width of a raster, in units of the drawing.
const WIDTH = 400;

// A number that is not defined is a dash.
const dash = (value) => value?.toFixed(2) ?? "–";
const count = (spikes, which) => which.reduce((sum, i) => sum + spikes[i].length, 0);

// `rates`: of the afferents at `places`; the largest of all maps is `most`. `outline`: lines that draw the shape.
function map(title, text, places, rates, most, outline) {
  const svg = drawing(`${title}: ${text}`);
  places.forEach(([x, y], i) => {
    const share = rates[i] / most;
    svg.append(make("circle", { cx: x, cy: -y, r: (0.14 + 0.24 * share).toFixed(2), ...(share > 0 ? { fill: tint(share), class: "dot" } : { class: "dot still" }) }));
  });
  const lines = make("g", { class: "over" });
  lines.append(...outline.map(line));
  svg.append(lines);
  return figure(title, text, svg);
}

// The maps: for each class the real thing and the display beside each other, with one scale of colours.
export function responses({ response, outline }) {
  return CLASSES.map((kind) => {
    const which = ofClass(response.class, kind);
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

// The rasters of both sides.
export function rasters({ response: { class: classes, places_mm, seconds, ...times } }) {
  return SIDES.map(([key, name]) => {
    const [svg, counts] = raster({ spikes: { class: classes, times_s: times[key], places_mm }, from_s: 0, seconds }, name, WIDTH);
    return figure(`${name}, spikes over time`, counts, svg);
  });
}

// The columns of the table, with how far a number is from that of the thing itself.
const far = { r: (r) => 1 - r, error: (error) => error };
const COLUMNS = [["r", far.r], ["error", far.error], ["r_by_class", far.r], ["error_by_class", far.error], ["spikes", (share) => Math.abs(Math.log(share))]];

// Rows for the table of figures. The best number of a column is bold.
export function rows([found, ...others]) {
  const all = [found, ...others];
  const cells = all.map(() => []);
  for (const [key, away] of COLUMNS) {
    // One number, or one of each class.
    [found[key]].flat().forEach((_, k) => {
      const texts = all.map((judged) => dash([judged[key]].flat()[k]));
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
