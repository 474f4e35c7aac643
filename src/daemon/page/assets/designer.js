// The view Design: the person draws a thing, and the page renders it, shows how near it comes, plays it and stores it.
//
// A drawing (`doc`) has: `shape`; `lines`, its points; `at`, the middle of what is not drawn point by point; `text`; `numbers`, by the id of
// their fields; `picture`, a height map's file; `touch` and `method`.

import { array } from "./array.js";
import { $, may, refuse, say, speak } from "./control.js";
import { History, keep, kept } from "./history.js";
import { Live } from "./live.js";
import { complain, forgive, number, numbers, right } from "./number.js";
import { Pad, TOO_MANY } from "./pad.js";
import { picture } from "./picture.js";
import { Rendering } from "./rendering.js";
import { drawn, live, off, rendering } from "./thing.js";
import { part } from "./views.js";

// After the last change of a number, before the page asks for a rendering.
const PAUSE_MS = 400;
const METHODS = {
  auto: "What simulated fingers find nearest to the real thing, for a press and for a motion. Take this first.",
  rate: "Strokes at full speed, until afferents fire as under the thing: for a motion.",
  field: "Pins take the shape of the skin.",
  rule: "Pins near the thing go their full travel at full speed: the plainest, sharp for an angle or a letter's name.",
  stroke: "Each pin makes one stroke whenever the thing passes: the plainest for a motion. What stays in place is pressed.",
  trace: "A press follows the lines, one after another: for letters and shapes that the pins are too coarse for. Its time is its own.",
};
// Which things a field is for, by the id of its field, and its label is `ID-label`.
const SHAPES = {
  width: ["bar", "polyline"], diameter: ["dots", "braille"], text: ["braille"], pitch: ["braille"], picture: ["heightmap"], mm: ["heightmap"],
  white: ["heightmap"], angle: ["braille", "heightmap"],
};
const TOUCHES = { depth: ["press", "scan"], rise: ["press"], hold: ["press"], fall: ["press"], speed: ["scan"], direction: ["scan"], distance: ["scan"] };
const NUMBERS = ["width", "diameter", "pitch", "mm", "white", "angle", ...Object.keys(TOUCHES)];
const TEXTS = ["text", "contact", "method"];

// The middle of a Braille cell near the array's middle, mm. Dots that are two pitches apart then lie right above pins.
function cellCenter() {
  const { grid } = array();
  return grid ? [grid.columns, grid.rows].map((count) => (count % 2 ? 0 : grid.pitch_mm / 2)) : [0, 0];
}

const digits = (value) => String(+value.toFixed(3));

export class Designer {
  #saved;
  #pad;
  #live;
  #rendering;
  #history = new History();
  #picture = null;
  #numbers = {};
  #timer = 0;
  // Whether a field has what cannot be drawn: then the drawing is older than the fields.
  #isWrong = false;
  // Whether nothing was rendered because this window may not.
  #isKept = false;
  // The drawing of before a reload, until the array is known.
  #before = kept();

  // `saved`: called when a pattern has been stored.
  constructor(saved) {
    this.#saved = saved;
    this.#pad = new Pad($("pad"), (by) => this.#drawn(by), (text) => speak(text, "pad"));
    const changed = () => this.#buttons();
    this.#rendering = new Rendering(() => (this.#keep(), this.#buttons()));
    const request = () => {
      const [object] = live(this.#doc());
      return object && { object };
    };
    const check = () => right(...this.#fields());
    this.#live = new Live({ pad: this.#pad, id: "thing-live", request, check, thing: () => drawn(this.#doc()), depth: () => number("depth"), changed });
    this.#bind();
    part({
      view: "design",
      at: "designer-title",
      load: () => this.#start(),
      state: () => (this.#rendering.doubt(), this.#rights()),
      on: { rendering: (event) => this.#rendering.handle(event) },
      hide: () => this.#live.end(),
    });
  }

  #bind() {
    const on = (id, event, run) => $(id).addEventListener(event, run);
    on("shape", "change", () => this.#changed());
    on("points", "change", () => this.#typed());
    on("undo", "click", () => this.#step(-1));
    on("redo", "click", () => this.#step(1));
    on("clear", "click", () => (this.#pad.set([]), this.#changed()));
    on("turn", "click", () => (this.#pad.set([this.#pad.points.toReversed()]), this.#changed()));
    for (const id of [...NUMBERS, ...TEXTS]) {
      on(id, "change", () => this.#changed());
      on(id, "input", () => {
        clearTimeout(this.#timer);
        this.#timer = setTimeout(() => this.#changed(), PAUSE_MS);
      });
    }
    on("depth", "input", () => this.#live.press());
    on("picture", "change", () => this.#take($("picture").files[0]));
    const panel = $("designer-title").parentElement;
    panel.addEventListener("dragover", (event) => event.preventDefault());
    panel.addEventListener("drop", (event) => (event.preventDefault(), this.#take(event.dataTransfer.files[0])));
    document.addEventListener("keydown", (event) => this.#key(event));
    on("thing-save-form", "submit", (event) => (event.preventDefault(), this.#save()));
    document.addEventListener("array", () => this.#arrange());
  }

  // The fields that the chosen thing and touch have.
  #fields() {
    const [shape, touch] = [$("shape").value, $("contact").value];
    const of = (fields, choice) => Object.keys(fields).filter((id) => fields[id].includes(choice));
    return [...of(SHAPES, shape), "contact", ...of(TOUCHES, touch)];
  }

  #doc() {
    // While a number is wrong, the one before it is drawn.
    for (const id of NUMBERS) if (!Number.isNaN(number(id))) this.#numbers[id] = number(id);
    return {
      shape: $("shape").value, lines: this.#pad.lines, at: this.#pad.at, text: $("text").value.toLowerCase(), picture: this.#picture,
      numbers: { ...this.#numbers }, touch: $("contact").value, method: $("method").value,
    };
  }

  // What can be undone, and survives a reload.
  #state() {
    const fields = Object.fromEntries([...NUMBERS, ...TEXTS].map((id) => [id, $(id).value]));
    return { shape: $("shape").value, lines: this.#pad.lines, at: this.#pad.at, picture: this.#picture, fields };
  }

  #restore({ shape, lines, at, picture, fields }) {
    for (const [id, value] of Object.entries(fields)) if ($(id)) $(id).value = value;
    this.#picture = picture;
    $("shape").value = shape;
    [this.#pad.lines, this.#pad.at] = [lines, at];
    this.#show();
  }

  #arrange() {
    if (!this.#history.now) {
      $("pitch").value = digits(2 * array().pitch_mm);
      this.#pad.at = cellCenter();
      this.#history.add(this.#state());
      if (this.#before) this.#again(this.#before);
    }
    this.#show();
  }

  // Takes the drawing of before a reload; one of another page's version may lack something.
  #again({ state }) {
    try {
      this.#restore(state);
      this.#history.add(state);
    } catch {
      this.#before = null;
    }
  }

  // Loads the rendering.
  async #start() {
    const before = this.#before?.rendering ?? undefined;
    this.#before = null;
    // The person may have drawn meanwhile. A daemon that was started again has no result.
    if (!this.#rendering.isAsking && !(await this.#rendering.resume(before))) this.#ask(false);
    this.#buttons();
  }

  async #take(file) {
    if (!file) return;
    try {
      this.#picture = await picture(file);
      $("shape").value = "heightmap";
      say($("shape"), "");
      this.#changed();
    } catch (error) {
      refuse($("shape"), error);
    }
  }

  #typed() {
    const lines = $("points").value.split("/").map(numbers);
    if (lines.some((of) => of.length % 2)) {
      this.#isWrong = true;
      this.#buttons();
      return say($("points"), "The last point has no y: enter x y; x y.", "bad");
    }
    say($("points"), "");
    const pairs = lines.map((of) => Array.from({ length: of.length / 2 }, (_, i) => of.slice(2 * i, 2 * i + 2)));
    if (this.#pad.isDrawn && !this.#pad.set(pairs)) {
      this.#isWrong = true;
      this.#buttons();
      return say($("points"), TOO_MANY, "bad");
    }
    if (!this.#pad.isDrawn && pairs[0].length) [this.#pad.at] = pairs[0];
    this.#pad.isFull = false;
    return this.#changed();
  }

  // The pen or the keys have drawn.
  #drawn(by) {
    if (by === "move") this.#show();
    else this.#changed(by === "pen");
  }

  // Handles a change of the drawing that is complete. `byPen`: the pen has left the pad.
  #changed(byPen = false) {
    clearTimeout(this.#timer);
    say($("points"), this.#pad.isFull ? TOO_MANY : "", "bad");
    this.#isWrong = !complain(...this.#fields());
    this.#show();
    if (this.#isWrong) return this.#rendering.ask(null);
    if (this.#history.add(this.#state())) this.#keep();
    else if (this.#rendering.isAsked) return undefined;
    this.#buttons();
    return this.#ask(byPen);
  }

  #step(by) {
    clearTimeout(this.#timer);
    // What cannot be drawn is no step of the drawing: it goes first.
    const state = by < 0 && this.#isWrong ? this.#history.now : this.#history.move(by);
    if (!state) return;
    this.#isWrong = false;
    this.#restore(state);
    // A field that is hidden may be wrong as well.
    forgive(...NUMBERS, ...TEXTS);
    say($("points"), "");
    speak(by < 0 ? "Undone." : "Done again.", "pad");
    this.#keep();
    this.#ask(false);
  }

  #key(event) {
    const key = event.key.toLowerCase();
    if (!(event.ctrlKey || event.metaKey) || event.altKey || !["z", "y"].includes(key) || !$("pad").checkVisibility()) return;
    // A field of text has an undo of its own.
    if (this.#pad.isTaken || event.target.matches("input:not([type=checkbox], [type=file])")) return;
    event.preventDefault();
    this.#step(key === "y" || event.shiftKey ? 1 : -1);
  }

  #keep() {
    const state = this.#history.now;
    if (!state) return;
    const rendering = this.#rendering.kept;
    const isKept = keep({ state, rendering });
    if (!isKept && state.picture) keep({ state: { ...state, picture: null }, rendering: null });
    $("picture-kept").hidden = isKept || !state.picture;
  }

  // Asks for the rendering of the drawing.
  #ask(byPen) {
    this.#rights();
    if (!may()) {
      this.#isKept = true;
    } else if (array()) {
      this.#rendering.ask(rendering(this.#doc()), byPen && $("thing-at-once").checked);
    }
  }

  // Says that this window may not render; when it may, it renders what was drawn meanwhile.
  #rights() {
    const isNew = $("thing-may-not").hidden === !may();
    $("thing-may-not").hidden = may();
    if (isNew && !may()) speak($("thing-may-not").textContent, "rendering");
    if (!may() || !this.#isKept) return;
    this.#isKept = false;
    this.#ask(false);
  }

  async #save() {
    const { result } = this.#rendering;
    if (!right("thing-name") || !result) return;
    const name = $("thing-name").value;
    try {
      await this.#rendering.save(result, name, $("thing-replace").checked);
      say($("thing-save"), `Saved the pattern ${name}.`);
      this.#saved();
    } catch (error) {
      refuse($("thing-save"), error);
    }
  }

  #show() {
    const shape = $("shape").value;
    const doc = this.#doc();
    this.#pad.shape = shape;
    const fields = this.#fields();
    for (const id of [...Object.keys(SHAPES), ...Object.keys(TOUCHES), "contact"]) $(`${id}-label`).hidden = !fields.includes(id);
    $("points-text").textContent = this.#pad.isDrawn ? (shape === "polyline" ? "Points, mm: x y; x y / next line" : "Points, mm: x y; x y") : "Middle, mm: x y";
    $("points").value = (this.#pad.isDrawn ? doc.lines : [[doc.at]]).map((places) => places.map((place) => place.join(" ")).join("; ")).join(" / ");
    $("white-text").textContent = doc.picture?.levels === 1 ? "µm for 1" : "µm for white";
    $("picture-note").textContent = shape !== "heightmap" ? "" : doc.picture ? `${doc.picture.name}: ${doc.picture.size.map((pixels) => digits(pixels * doc.numbers.mm)).join(" × ")} mm. ${doc.picture.note}` : "Drop a PNG or NPY file here, or choose one.";
    $("pitch-note").hidden = shape !== "braille";
    const isTraced = shape !== "heightmap" && doc.touch === "press";
    $("method").querySelector('[value="trace"]').disabled = !isTraced;
    if (!isTraced && doc.method === "trace") $("method").value = "auto";
    $("method-note").textContent = METHODS[$("method").value];
    $("where-note").textContent = off(doc);
    this.#pad.show(drawn(doc));
    this.#buttons();
  }

  #buttons() {
    const { shape } = this.#pad;
    $("undo").disabled = this.#pad.isTaken || !(this.#history.canUndo || this.#isWrong);
    $("redo").disabled = this.#pad.isTaken || !this.#history.canRedo;
    $("clear").hidden = !this.#pad.isDrawn;
    $("clear").disabled = this.#pad.isTaken || !this.#pad.lines.length;
    $("turn").hidden = shape !== "edge";
    $("turn").disabled = this.#pad.points.length < 2;
    $("thing-live-why").textContent = live(this.#doc())[1];
    $("thing-live-help").hidden = !this.#pad.isTaken;
    this.#live.buttons();
  }
}
