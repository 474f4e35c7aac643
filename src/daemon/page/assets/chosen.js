// The chosen pattern: its figures, and its file. The list plays it.

import { call, DISK_MS } from "./api.js";
import { array, isForeign } from "./array.js";
import { $, element, open, refuse, saveFile, say } from "./control.js";
import { complain, forgive, number } from "./number.js";
import { figures, preview } from "./preview.js";
import { toml } from "./toml.js";

const MOTIONS = ["wave", "ramp", "tone", "noise"];
// Pieces of patterns that are kept, at most.
const MOST_PREVIEWS = 40;

export class Chosen {
  // The chosen pattern, as the list has it.
  #first = null;
  // The chosen pattern in full.
  #full = null;
  #details;
  #check;
  #stored;
  #marked;
  // The pattern that a person is asked about, whether to remove it.
  #removed = null;
  // The pin whose trace is shown in large.
  #motor = 0;
  #previews = new Map();
  // Counts what a person has asked for: an answer to an earlier question shows nothing.
  #asked = 0;

  // `details(pattern)`: one of the list in full. `check(pattern)`: throws if the daemon has another one by now. `stored`: called when the stored
  // ones have changed. `marked`: called when another pattern is chosen.
  constructor({ details, check, stored, marked }) {
    [this.#details, this.#check, this.#stored, this.#marked] = [details, check, stored, marked];
    const on = (id, event, run) => $(id).addEventListener(event, run);
    on("chosen-remove", "click", () => this.#askToRemove());
    on("remove-dialog", "close", () => $("remove-dialog").returnValue === "remove" && this.#run($("chosen-remove"), () => this.#remove()));
    on("chosen-keep", "click", () => this.#run($("chosen-keep"), () => saveFile([toml(this.#full.pattern)], "application/toml", `${this.#first.name}.toml`)));
    for (const id of ["preview-from", "preview-seconds"]) on(id, "change", () => this.#draw());
    on("preview-motor", "change", () => complain("preview-motor") && this.#choosePin(number("preview-motor")));
    document.addEventListener("pin", ({ detail }) => this.#choosePin(detail));
    document.addEventListener("array", () => this.choose(null));
  }

  // The name of the chosen pattern; null for none.
  get name() {
    return this.#first?.name ?? null;
  }

  // Shows a pattern of the list; null for none.
  async choose(pattern) {
    const asked = this.#begin(pattern);
    if (!pattern) return;
    try {
      const full = await this.#details(pattern);
      if (asked !== this.#asked) return;
      this.#full = full;
      this.#show();
    } catch (error) {
      if (asked === this.#asked) refuse($("chosen-title"), error);
    }
  }

  #begin(pattern) {
    [this.#first, this.#full] = [pattern, null];
    this.#marked();
    $("chosen-title").textContent = pattern ? `Pattern ${pattern.name}` : "Pattern";
    $("chosen-none").hidden = Boolean(pattern);
    $("chosen-body").hidden = true;
    say($("chosen-title"), "");
    return ++this.#asked;
  }

  // Takes the patterns that are stored now, by name.
  renew(patterns) {
    const first = patterns.get(this.name) ?? null;
    if (this.#first && first?.sha256 !== this.#first.sha256) this.choose(first);
  }

  #show() {
    const { library, array: of } = this.#first;
    const { pattern, warnings } = this.#full;
    $("chosen-warnings").textContent = warnings.join(" · ");
    $("chosen-remove").hidden = library;
    $("preview-from").value = 0;
    $("preview-motor").max = array().positions_mm.length - 1;
    const first = [...(pattern.drive ?? []), ...MOTIONS.flatMap((key) => pattern[key] ?? [])][0]?.motor ?? 0;
    this.#motor = $("preview-motor").value = first;
    forgive("preview-motor");
    $("previews-part").hidden = isForeign(this.#first);
    $("foreign-note").hidden = !isForeign(this.#first);
    $("foreign-note").textContent = `It is for the array ${of}. Where its pins stand is not known here, so the page does not draw it.`;
    $("chosen-body").hidden = false;
    $("chosen-title").scrollIntoView({ block: "nearest" });
    this.#draw();
  }

  // Does something for a button, and says beside it what came of it.
  async #run(button, work) {
    try {
      await work();
      say(button, "");
    } catch (error) {
      refuse(button, error);
    }
  }

  #askToRemove() {
    $("remove-text").replaceChildren("The daemon removes the file of ", element("strong", this.#first.name), ". This cannot be taken back.");
    this.#removed = this.#first;
    open($("remove-dialog"));
  }

  async #remove() {
    const removed = this.#removed;
    await this.#check(removed);
    await call("DELETE", `/v1/patterns/${encodeURIComponent(removed.name)}`, undefined, DISK_MS);
    if (this.#first === removed) this.choose(null);
    this.#stored();
  }

  #choosePin(motor) {
    if (!this.#full || !(motor >= 0 && motor < array().positions_mm.length)) return;
    this.#motor = $("preview-motor").value = motor;
    forgive("preview-motor");
    this.#draw();
  }

  // A piece of a pattern, fetched once.
  #preview({ name, sha256 }, from, seconds) {
    const key = `${name} ${sha256} ${from} ${seconds}`;
    if (!this.#previews.has(key)) {
      if (this.#previews.size >= MOST_PREVIEWS) this.#previews.clear();
      const fetched = preview(name, from, seconds);
      this.#previews.set(key, fetched);
      fetched.catch(() => this.#previews.delete(key));
    }
    return this.#previews.get(key);
  }

  async #draw() {
    if (!this.#full || isForeign(this.#first) || !complain("preview-from")) return;
    const asked = ++this.#asked;
    const shown = this.#first;
    const piece = [number("preview-from"), $("preview-seconds").value];
    const wait = setTimeout(() => say($("preview-from"), "The daemon computes the figures …", "wait"), 300);
    try {
      const found = await this.#preview(shown, ...piece);
      if (asked !== this.#asked) return;
      // Others may have stored another one meanwhile.
      if (found.sha256 !== shown.sha256) {
        this.#previews.clear();
        this.#stored();
      }
      const width = Math.floor($("previews").clientWidth) - 16;
      $("previews").replaceChildren(figures(found, shown.name, this.#motor, width, (motor) => this.#choosePin(motor)));
      say($("preview-from"), "");
    } catch (error) {
      if (asked !== this.#asked) return;
      $("previews").replaceChildren();
      refuse($("preview-from"), error);
    } finally {
      clearTimeout(wait);
    }
  }
}
