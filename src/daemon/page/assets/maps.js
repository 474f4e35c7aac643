// Maps of the predicted response: each afferent is a dot on the pad, whose colour and size show its rate. The figures stand beside
// the maps.

import { element } from "./control.js";
import { colour, make } from "./finger.js";
import { drawing, line } from "./pad.js";

const RULES = [["naive_reach", "Rule of thumb, within reach"], ["naive_pitch", "Rule of thumb, within one pitch"]];

// `rates`: of the afferents at `places`; the largest of all maps is `most`. `outline`: lines that draw the shape.
export function map(title, text, places, rates, most, outline) {
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

// The maps of target, found pattern and both rules of thumb, with one scale of colours.
export function maps({ response, models, outline }) {
  const own = models.find((of) => of.model === response.model);
  const patterns = [["found", "Found pattern"], ...RULES];
  const most = Math.max(1, ...patterns.flatMap(([key]) => response[key]));
  const figures = patterns.map(([key, title]) => map(title, `contrast ${own[key].contrast.toFixed(1)} impulses/s`, response.places_mm, response[key], most, outline));
  const on = response.on.filter((share) => share > 0).length;
  return {
    figures: [map("Target", `${on} of ${response.on.length} afferents should fire`, response.places_mm, response.on, 1, outline), ...figures],
    legend: `Each dot is an RA afferent of the model “${response.model}”. Small and grey: silent; large and bright: ${most.toFixed(0)} impulses/s.`,
  };
}

// Rows for the table of figures: under each model the pattern, then both rules.
export function figures({ models }) {
  return models.flatMap((of) => [["found", "Found pattern"], ...RULES].map(([key, title]) => {
    const row = document.createElement("tr");
    const { on, off, contrast, auc } = of[key];
    row.append(element("th", title, { scope: "row" }), ...[of.model, on.toFixed(1), off.toFixed(1), contrast.toFixed(1), auc.toFixed(3)].map((text) => element("td", text)));
    return row;
  }));
}
