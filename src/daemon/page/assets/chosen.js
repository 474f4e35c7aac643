// The chosen pattern: its figures, with those of a second one beside them, and its drives, which a person changes, plays and saves under
// another name. The window keeps what is changed and not saved: a reload shows it again, and another pattern takes its place only after a
// question.

import { call, DISK_MS, known, order, poll, put } from "./api.js";
import { array } from "./array.js";
import { element, facts, open, ordered, orders, refuse, restored, say } from "./control.js";
import { Drives } from "./drives.js";
import { checkArray, isForeign } from "./foreign.js";
import { complain, forgive, number, optional, right } from "./number.js";
import { figures, highest, preview } from "./preview.js";
import { addItem } from "./sequence.js";
import { keep, toml } from "./toml.js";

const $ = (id) => document.getElementById(id);
const MOTIONS = ["wave", "ramp", "tone", "noise"];
// Changes of the scale within this time begin the play once, ms.
const AGAIN_MS = 300;
const KEPT = "meissner-edited";
// Larger changes are not kept: the window needs the place for its session's token.
const MOST_KEPT = 1e6;
// Pieces of patterns that are kept, at most.
const MOST_PREVIEWS = 40;

export class Chosen {
  // The chosen pattern and the second one, each as the list has it.
  #first = null;
  #second = null;
  // The chosen pattern in full.
  #full = null;
  // The patterns of the list, by name.
  #listed = new Map();
  #details;
  #check;
  #stored;
  #marked;
  // The pattern that a person wants in place of one with changes that are not saved.
  #next = null;
  // What was changed before a reload, until the list is there.
  #kept = restored(KEPT);
  #drives = new Drives(() => this.#buttons());
  // The duration and the drives as they are stored.
  #before = "";
  // The pattern that a person has saved here, until the list has it.
  #saved = null;
  // The pattern that a person is asked about, whether to remove it.
  #removed = null;
  // The last play of the chosen pattern that was ordered here: its `id` and its `body`.
  #played = null;
  #again;
  // The pin whose trace is shown in large.
  #motor = 0;
  #previews = new Map();
  // Counts what a person has asked for: an answer to an earlier question shows nothing.
  #asked = 0;

  // `details(pattern)`: one of the list in full. `check(pattern)`: throws if the daemon has another one by now. `stored`: called when one was
  // stored. `marked`: called when another pattern is chosen.
  constructor({ details, check, stored, marked }) {
    [this.#details, this.#check, this.#stored, this.#marked] = [details, check, stored, marked];
    const on = (id, event, run) => $(id).addEventListener(event, run);
    orders($("chosen-play"), () => (this.#isRight() ? this.#play() : undefined));
    on("chosen-add", "click", () => this.#run($("chosen-add"), () => this.#add()));
    on("chosen-scale", "input", () => this.#showScale());
    on("chosen-scale", "change", () => {
      clearTimeout(this.#again);
      this.#again = setTimeout(() => this.#playAgain().catch((error) => refuse($("chosen-play"), error)), AGAIN_MS);
    });
    on("chosen-remove", "click", () => this.#askToRemove());
    on("remove-dialog", "close", () => $("remove-dialog").returnValue === "remove" && this.#run($("chosen-remove"), () => this.#remove()));
    on("discard-dialog", "close", () => $("discard-dialog").returnValue === "discard" && this.choose(this.#next));
    on("chosen-undo", "click", () => this.#undo());
    on("chosen-duration", "input", () => this.#buttons());
    on("chosen-keep", "click", () => this.#run($("chosen-keep"), () => this.#keep()));
    on("chosen-save-form", "submit", (event) => (event.preventDefault(), this.#run($("chosen-save"), () => this.#save())));
    for (const id of ["preview-from", "preview-seconds"]) on(id, "change", () => this.#draw());
    on("preview-motor", "change", () => complain("preview-motor") && this.#choosePin(number("preview-motor")));
    on("compare-end", "click", () => this.compare(null));
    document.addEventListener("pin", ({ detail }) => this.#choosePin(detail));
    document.addEventListener("array", () => this.choose(null));
  }

  // The names of the chosen pattern and of the second one; null for none.
  get names() {
    return [this.#first?.name ?? null, this.#second?.name ?? null];
  }

  // Shows a pattern of the list that a person has chosen.
  ask(pattern) {
    if (!this.#isEdited()) return void this.choose(pattern);
    this.#next = pattern;
    $("discard-text").replaceChildren("What you have changed in ", element("strong", this.#first.name), " is not saved.");
    open($("discard-dialog"));
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
    [this.#first, this.#full, this.#played] = [pattern, null, null];
    if (!pattern || this.#second?.name === pattern.name) this.#second = null;
    this.#marked();
    $("chosen-title").textContent = pattern ? `Pattern ${pattern.name}` : "Pattern";
    $("chosen-none").hidden = Boolean(pattern);
    $("chosen-body").hidden = true;
    say($("chosen-title"), "");
    return ++this.#asked;
  }

  // Shows again what was changed before a reload.
  #restore({ first, full, duration, drives }) {
    this.#begin(first);
    this.#full = full;
    this.#show();
    $("chosen-duration").value = duration;
    // A number that was missing or wrong is null.
    const whole = (drive) => Object.fromEntries(Object.entries(drive).filter(([, value]) => value !== null));
    this.#drives.take({ ...full.pattern, drive: drives.map(whole) });
    this.#buttons();
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
    const [kept, before] = [this.#kept, this.#listed];
    [this.#kept, this.#listed] = [null, patterns];
    const isRestored = Boolean(kept?.full?.pattern) && !this.#first && !isForeign(kept.first);
    if (isRestored) this.#restore(kept);
    const saved = patterns.get(this.#saved);
    this.#saved = null;
    if (saved) {
      this.choose(saved);
      return;
    }
    const [first, second] = this.names.map((name) => patterns.get(name) ?? null);
    if (second?.sha256 !== this.#second?.sha256) this.compare(second);
    if (!this.#first || first?.sha256 === this.#first.sha256) return;
    if (!this.#isEdited()) return void this.choose(first);
    // It was said already.
    if (!isRestored && before.get(this.#first.name)?.sha256 === first?.sha256) return;
    say($("chosen-title"), `${first ? "Another pattern was stored under this name" : "This pattern was removed"} meanwhile. Your changes are those of the one before: save them under another name.`, "bad");
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
    $("chosen-remove").hidden = library;
    $("save-as").value = `${this.#first.name.slice(0, 60)}-new`;
    $("preview-from").value = 0;
    $("preview-motor").max = array().positions_mm.length - 1;
    const first = [...(pattern.drive ?? []), ...MOTIONS.flatMap((key) => pattern[key] ?? [])][0]?.motor ?? 0;
    this.#motor = $("preview-motor").value = first;
    forgive("preview-motor");
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

  // Shows what is stored, by now.
  #undo() {
    const now = this.#listed.get(this.#first.name);
    if (now && now.sha256 !== this.#first.sha256) this.choose(now);
    else this.#edit();
  }

  #fields() {
    return JSON.stringify([$("chosen-duration").value, this.#drives.value]);
  }

  #isEdited() {
    return this.#full !== null && this.#fields() !== this.#before;
  }

  #buttons() {
    const fields = this.#fields();
    const isEdited = this.#full !== null && fields !== this.#before;
    $("chosen-undo").disabled = !isEdited;
    $("chosen-play").textContent = isEdited ? "Play as changed" : "Play";
    $("chosen-edited").hidden = !isEdited;
    // The pattern in full is some times as long as its fields.
    const kept = isEdited && 4 * fields.length <= MOST_KEPT ? JSON.stringify({ first: this.#first, full: this.#full, duration: $("chosen-duration").value, drives: this.#drives.value }) : "";
    if (kept && kept.length <= MOST_KEPT) sessionStorage.setItem(KEPT, kept);
    else sessionStorage.removeItem(KEPT);
  }

  // The pattern as the fields have it. Where it comes from stays known.
  #pattern() {
    if (!this.#isEdited()) return this.#full.pattern;
    const { duration_s: _, drive: __, provenance: ___, ...rest } = this.#full.pattern;
    const duration = optional("chosen-duration");
    const drives = this.#drives.value.length ? { drive: this.#drives.value } : {};
    return { ...rest, ...(duration === undefined ? {} : { duration_s: duration }), ...drives, provenance: { changed_from: this.#first.name, changed_from_sha256: this.#full.sha256 } };
  }

  // How long to play, s, as the key of a play; none for one run.
  #seconds() {
    const count = number("chosen-count");
    if ($("chosen-unit").value === "seconds") return { seconds: count };
    const run = this.#isEdited() ? optional("chosen-duration") : this.#first.duration_s;
    if (!run) throw new Error("A pattern without end needs seconds: choose that unit.");
    return count === 1 ? {} : { seconds: count * run };
  }

  #isRight() {
    return right("chosen-duration", ...this.#drives.fields);
  }

  // Does something for a button, and says beside it what came of it.
  async #run(button, work) {
    if (!this.#isRight()) return;
    try {
      say(button, (await work()) ?? "");
    } catch (error) {
      refuse(button, error);
    }
  }

  // What the fields say, as keys of a play or of an item of a sequence.
  #what() {
    const pattern = this.#isEdited() ? this.#pattern() : this.#first.name;
    return { pattern, ...this.#seconds(), scale: $("chosen-scale").valueAsNumber };
  }

  async #play() {
    if (!right("chosen-count")) return undefined;
    const first = this.#first;
    checkArray(first);
    const body = this.#what();
    if (this.#isEdited()) return this.#order(body);
    await this.#check(first);
    return this.#order({ ...body, pattern_sha256: first.sha256 });
  }

  async #order(body) {
    const first = this.#first;
    const answer = await order("/v1/play", body);
    if (first === this.#first) this.#played = { id: answer.id, body };
    return ordered(answer);
  }

  // Begins the play that runs anew with another scale, as it was ordered, if it was ordered here.
  async #playAgain() {
    const [played, scale] = [this.#played, $("chosen-scale").valueAsNumber];
    if (!played || scale === played.body.scale) return;
    await poll();
    const { play, queued } = known() ?? {};
    const name = played.body.pattern.name ?? played.body.pattern;
    if (play?.id !== played.id || play.pattern !== name) return;
    say($("chosen-play"), queued.length ? "Other plays wait: the new scale holds from the next play on." : await this.#order({ ...played.body, scale, replace: true }));
  }

  #showScale() {
    $("chosen-scale-value").textContent = $("chosen-scale").value;
  }

  async #add() {
    if (!right("chosen-count", "sequence-gap")) return undefined;
    checkArray(this.#first);
    const item = this.#what();
    if (!this.#isEdited()) await this.#check(this.#first);
    return addItem(item);
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
    if (this.#first === removed) {
      sessionStorage.removeItem(KEPT);
      this.choose(null);
    }
    this.#stored();
  }

  async #save() {
    if (!right("save-as")) return undefined;
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
    const shown = [this.#first, this.#second].filter(Boolean);
    $("compare-end").hidden = !this.#second;
    const piece = [number("preview-from"), $("preview-seconds").value];
    const wait = setTimeout(() => say($("preview-from"), "The daemon computes the figures …", "wait"), 300);
    try {
      const found = await Promise.all(shown.map((pattern) => this.#preview(pattern, ...piece)));
      if (asked !== this.#asked) return;
      // Others may have stored another one meanwhile.
      if (found.some((of, i) => of.sha256 !== shown[i].sha256)) {
        this.#previews.clear();
        this.#stored();
      }
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
