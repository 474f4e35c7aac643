// The drives of a pattern as a table that can be edited, and the map of the pins that they move.

import { array } from "./array.js";
import { built, element } from "./control.js";
import { thumbnail } from "./finger.js";
import { number, optional } from "./number.js";

const $ = (id) => document.getElementById(id);
// Rows that are shown, at most: a pattern has up to 4096 drives.
export const ROWS = 200;
const NEW = { motor: 0, frequency_hz: 60, amplitude_um: 80, phase: 0 };
// Key, name, the range that the daemon allows, and the step of the arrow keys; whether it may be empty.
const COLUMNS = [
  ["motor", "Motor", 0, null, 1], ["frequency_hz", "Frequency, Hz", 0.1, 300, 1], ["amplitude_um", "Amplitude, µm", 0, null, 1], ["phase", "Phase, periods", 0, 0.999999, 0.05],
  ["start_s", "From, s", 0, 1e8, 0.1, true], ["stop_s", "To, s", 0, 1e8, 0.1, true],
];

export class Drives {
  #drives = [];
  // The pattern as it is stored: its motions are on the map, too.
  #pattern = {};
  #changed;
  #number = 0;
  // Counts what was to be shown: of two tables the newer one stays.
  #asked = 0;

  // `changed`: called when a person has changed a drive, has added or has removed one.
  constructor(changed) {
    this.#changed = changed;
    $("drives-add").addEventListener("click", async () => {
      const last = this.#drives.at(-1) ?? NEW;
      const { motor, ...rest } = last;
      this.#drives.push({ ...rest, motor: (motor + 1) % array().positions_mm.length });
      changed();
      await this.#show();
      $("drives").tBodies[0].lastChild?.querySelector("input")?.focus();
    });
  }

  // The drives as they stand in the table; a number that is missing or wrong is NaN.
  get value() {
    return this.#drives;
  }

  // Shows the drives of a pattern.
  take(pattern) {
    this.#pattern = pattern;
    this.#drives = (pattern.drive ?? []).map((drive) => ({ ...drive }));
    this.#show();
  }

  // The ids of all fields.
  get fields() {
    return [...$("drives").querySelectorAll("input")].map((input) => input.id);
  }

  async #show() {
    const asked = ++this.#asked;
    const shown = this.#drives.slice(0, ROWS);
    const hidden = this.#drives.length - shown.length;
    $("drives-note").textContent = hidden ? `${hidden} more drives are not shown: they are played and saved as they are.` : this.#drives.length ? "" : "No drives.";
    this.#map();
    const rows = await built(shown, (drive, i) => this.#row(drive, i));
    if (asked === this.#asked) $("drives").tBodies[0].replaceChildren(...rows);
  }

  #map() {
    const drives = this.#drives.map(({ motor, amplitude_um: um }) => ({ motor, reached_um: um || 0 }));
    $("drives-map").replaceChildren(thumbnail({ drives, pattern: this.#pattern }));
  }

  #row(drive, i) {
    const row = document.createElement("tr");
    for (const [key, title, min, max, step, isOptional] of COLUMNS) {
      const most = max ?? (key === "motor" ? array().positions_mm.length - 1 : array().motor.travel_um);
      const input = element("input", "", { inputMode: key === "motor" ? "numeric" : "decimal", id: `drive-${this.#number++}`, min, max: most, step, required: !isOptional, autocomplete: "off", ariaLabel: `Drive ${i + 1}: ${title}` });
      input.value = drive[key] ?? (key === "phase" ? 0 : "");
      input.addEventListener("input", () => {
        const value = isOptional ? optional(input.id) : number(input.id);
        if (value === undefined) delete drive[key];
        else drive[key] = value;
        this.#map();
        this.#changed();
      });
      row.append(document.createElement("td"));
      row.lastChild.append(input);
    }
    const remove = element("button", "✕", { type: "button", title: "Remove", ariaLabel: `Remove drive ${i + 1}` });
    remove.addEventListener("click", async () => {
      this.#drives.splice(this.#drives.indexOf(drive), 1);
      this.#changed();
      await this.#show();
      const rows = $("drives").tBodies[0].rows;
      (rows[Math.min(i, rows.length - 1)]?.querySelector("button") ?? $("drives-add")).focus();
    });
    row.append(document.createElement("td"));
    row.lastChild.append(remove);
    return row;
  }
}
