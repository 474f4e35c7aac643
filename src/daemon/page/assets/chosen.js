// The chosen pattern: its figures, with those of a second one beside them, and its drives, which a person changes, plays and saves under
// another name.

import { order, put } from "./api.js";
import { array } from "./array.js";
import { element, facts, refuse, say, valid } from "./control.js";
import { Drives } from "./drives.js";
import { isForeign, mapping } from "./foreign.js";
import { figures, highest, preview } from "./preview.js";
import { keep, toml } from "./toml.js";

const $ = (id) => document.getElementById(id);
const MOTIONS = ["wave", "ramp", "tone", "noise"];

export class Chosen {
  // The chosen pattern and the second one, each as the list has it.
  #first = null;
  #second = null;
  // The chosen pattern in full.
  #full = null;
  #details;
  #stored;
  #marked;
  #drives = new Drives(() => this.#buttons());
  // The duration and the drives as they are stored.
  #before = "";
  // The pattern that a person has saved here, until the list has it.
  #saved = null;
  // The pin whose trace is shown in large.
  #motor = 0;
  #previews = new Map();
  // Counts what a person has asked for: an answer to an earlier question shows nothing.
  #asked = 0;

  // `details(name)`: a pattern in full. `stored`: called when one was stored. `marked`: called when another pattern is chosen.
  constructor(details, stored, marked) {
    [this.#details, this.#stored, this.#marked] = [details, stored, marked];
    const on = (id, event, run) => $(id).addEventListener(event, run);
    on("chosen-play", "click", () => this.#run($("chosen-play"), () => this.#play()));
    on("chosen-undo", "click", () => this.#edit());
    on("chosen-duration", "input", () => this.#buttons());
    on("chosen-keep", "click", () => this.#run($("chosen-keep"), () => this.#keep()));
    on("chosen-save-form", "submit", (event) => (event.preventDefault(), this.#run($("chosen-save"), () => this.#save())));
    for (const id of ["preview-from", "preview-seconds"]) on(id, "change", () => this.#draw());
    on("preview-motor", "change", () => this.#choosePin($("preview-motor").valueAsNumber));
    on("compare-end", "click", () => this.compare(null));
    document.addEventListener("pin", ({ detail }) => this.#choosePin(detail));
    document.addEventListener("array", () => this.choose(null));
  }

  // The names of the chosen pattern and of the second one; null for none.
  get names() {
    return [this.#first?.name ?? null, this.#second?.name ?? null];
  }

  // Shows a pattern of the list; null for none.
  async choose(pattern) {
    const asked = ++this.#asked;
    [this.#first, this.#full] = [pattern, null];
    if (!pattern || this.#second?.name === pattern.name) this.#second = null;
    this.#marked();
    $("chosen-title").textContent = pattern ? `Pattern ${pattern.name}` : "Pattern";
    $("chosen-none").hidden = Boolean(pattern);
    $("chosen-body").hidden = true;
    say($("chosen-title"), "");
    if (!pattern) return;
    try {
      const full = await this.#details(pattern.name);
      if (asked !== this.#asked) return;
      this.#full = full;
      this.#show();
    } catch (error) {
      if (asked === this.#asked) refuse($("chosen-title"), error);
    }
  }

  // Shows a second pattern of the list beside the first; null for none.
  compare(pattern) {
    this.#second = pattern?.name === this.#first?.name ? null : pattern;
    this.#marked();
    this.#draw();
    $("previews-title").scrollIntoView({ block: "nearest" });
  }

  // Takes the patterns that are stored now, by name. What a person has changed stays, until it is saved: then that pattern is chosen.
  renew(patterns) {
    this.#previews.clear();
    const saved = patterns.get(this.#saved);
    this.#saved = null;
    if (saved) {
      this.choose(saved);
      return;
    }
    const [first, second] = this.names.map((name) => patterns.get(name) ?? null);
    if (second?.sha256 !== this.#second?.sha256) this.compare(second);
    if (this.#first && first?.sha256 !== this.#first.sha256 && !this.#isEdited()) this.choose(first);
  }

  #show() {
    const { duration_s: duration, library, array: of } = this.#first;
    const { pattern, warnings } = this.#full;
    const motions = MOTIONS.reduce((sum, key) => sum + (pattern[key]?.length ?? 0), 0);
    facts($("chosen-facts"), [
      ["Duration of one run", duration === null ? "without end" : `${duration} s`],
      ["Drives, motions", `${pattern.drive?.length ?? 0}, ${motions}`],
      ["Array", of],
      ["Stored", library ? "in the library" : "at this site"],
    ]);
    $("chosen-warnings").textContent = warnings.join(" · ");
    $("motions-note").hidden = !motions;
    // A run without end needs seconds.
    [$("chosen-count").value, $("chosen-unit").value] = [1, duration === null ? "seconds" : "times"];
    $("save-as").value = `${this.#first.name.slice(0, 60)}-new`;
    $("preview-from").value = 0;
    $("preview-motor").max = array().positions_mm.length - 1;
    const first = [...(pattern.drive ?? []), ...MOTIONS.flatMap((key) => pattern[key] ?? [])][0]?.motor ?? 0;
    this.#motor = $("preview-motor").value = first;
    for (const part of ["drives-part", "previews-part"]) $(part).hidden = isForeign(this.#first);
    $("foreign-note").hidden = !isForeign(this.#first);
    $("foreign-note").textContent = `It is for the array ${of}. Where its pins stand is not known here, so the page neither draws nor changes it.`;
    this.#edit();
    $("chosen-body").hidden = false;
    $("chosen-title").scrollIntoView({ block: "nearest" });
    this.#draw();
  }

  // Fills the fields with what is stored.
  #edit() {
    const { pattern } = this.#full;
    $("chosen-duration").value = pattern.duration_s ?? "";
    this.#drives.take(isForeign(this.#first) ? {} : pattern);
    this.#before = this.#fields();
    this.#buttons();
  }

  #fields() {
    return JSON.stringify([$("chosen-duration").value, this.#drives.value]);
  }

  #isEdited() {
    return this.#full !== null && this.#fields() !== this.#before;
  }

  #buttons() {
    const isEdited = this.#isEdited();
    $("chosen-undo").disabled = !isEdited;
    $("chosen-play").textContent = isEdited ? "Play as changed" : "Play";
    $("chosen-edited").hidden = !isEdited;
  }

  // The pattern as the fields have it. Where it comes from stays known.
  #pattern() {
    if (!this.#isEdited()) return this.#full.pattern;
    const { duration_s: _, drive: __, provenance: ___, ...rest } = this.#full.pattern;
    const duration = $("chosen-duration").value === "" ? {} : { duration_s: $("chosen-duration").valueAsNumber };
    const drives = this.#drives.value.length ? { drive: this.#drives.value } : {};
    return { ...rest, ...duration, ...drives, provenance: { changed_from: this.#first.name, changed_from_sha256: this.#full.sha256 } };
  }

  // How long to play, s, as the key of a play; none for one run.
  #seconds() {
    const count = $("chosen-count").valueAsNumber;
    if ($("chosen-unit").value === "seconds") return { seconds: count };
    if (count === 1) return {};
    const run = this.#isEdited() ? $("chosen-duration").valueAsNumber || null : this.#first.duration_s;
    if (!run) throw new Error("A pattern without a duration cannot be repeated: enter seconds.");
    return { seconds: count * run };
  }

  // Does something for a button, and says beside it what came of it.
  async #run(button, work) {
    if (!valid("chosen-duration", ...this.#drives.fields)) return;
    try {
      say(button, (await work()) ?? "");
    } catch (error) {
      refuse(button, error);
    }
  }

  async #play() {
    if (!valid("chosen-count", "chosen-scale")) return;
    const pattern = this.#isEdited() ? this.#pattern() : this.#first.name;
    await order("/v1/play", { pattern, ...this.#seconds(), scale: $("chosen-scale").valueAsNumber, ...mapping(this.#first) });
  }

  async #save() {
    if (!valid("save-as")) return;
    const name = $("save-as").value;
    const { warnings } = await put(`/v1/patterns/${name}${$("save-replace").checked ? "?replace=true" : ""}`, toml({ ...this.#pattern(), name }));
    this.#saved = name;
    this.#stored();
    return [`Saved ${name}.`, ...warnings].join(" ");
  }

  #keep() {
    keep(toml(this.#pattern()), "application/toml", `${this.#first.name}.toml`);
  }

  #choosePin(motor) {
    if (!this.#full || !(motor >= 0 && motor < array().positions_mm.length)) return;
    this.#motor = $("preview-motor").value = motor;
    this.#draw();
  }

  // A piece of a pattern, fetched once.
  #preview({ name }, from, seconds) {
    const key = `${name} ${from} ${seconds}`;
    if (!this.#previews.has(key)) {
      const fetched = preview(name, from, seconds);
      this.#previews.set(key, fetched);
      fetched.catch(() => this.#previews.delete(key));
    }
    return this.#previews.get(key);
  }

  async #draw() {
    if (!this.#full || isForeign(this.#first) || !valid("preview-from")) return;
    const asked = ++this.#asked;
    const shown = [this.#first, this.#second].filter(Boolean);
    $("compare-end").hidden = !this.#second;
    const piece = [$("preview-from").valueAsNumber, $("preview-seconds").value];
    const wait = setTimeout(() => say($("preview-from"), "The daemon computes the figures …", "wait"), 300);
    try {
      const found = await Promise.all(shown.map((pattern) => this.#preview(pattern, ...piece)));
      if (asked !== this.#asked) return;
      // Both have the same scale.
      const high = Math.max(...found.map(highest));
      const width = Math.floor($("previews").clientWidth / found.length) - 16;
      $("previews").replaceChildren(...found.map((of, i) => figures(of, shown[i].name, high, this.#motor, width, (motor) => this.#choosePin(motor))));
      clearTimeout(wait);
      say($("preview-from"), "");
    } catch (error) {
      if (asked !== this.#asked) return;
      clearTimeout(wait);
      $("previews").replaceChildren();
      refuse($("preview-from"), error);
    } finally {
      clearTimeout(wait);
    }
  }
}
