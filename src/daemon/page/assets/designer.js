// The designer: the person draws or loads a target, the daemon searches for a pattern, and the page shows, plays and saves the
// pattern found.

import { call, order, put } from "./api.js";
import { array } from "./array.js";
import { refuse, say, speak, valid } from "./control.js";
import { Live } from "./live.js";
import { figures, maps } from "./maps.js";
import { Pad } from "./pad.js";
import { part } from "./views.js";

const $ = (id) => document.getElementById(id);
const BRAILLE = "⠁⠃⠉⠙⠑⠋⠛⠓⠊⠚⠅⠇⠍⠝⠕⠏⠟⠗⠎⠞⠥⠧⠺⠭⠽⠵";
// The amplitude of a new target, if the motors go so far, µm.
const AMPLITUDE_UM = 80;
const DRAWN = ["segment", "polyline", "dots"];
const SHAPE_KEYS = ["name", "shape", "points", "center_mm", "radius_mm", "character", "dot_pitch_mm", "period_mm", "angle_deg", "offset_mm", "reach_mm", "amplitude_um"];

// The middle of a Braille cell near the array's middle, mm. Its dots are two pitches apart: in rows and columns they lie right above pins.
function cellCenter() {
  const { grid } = array();
  return grid ? [grid.columns, grid.rows].map((count) => (count % 2 ? 0 : grid.pitch_mm / 2)) : [0, 0];
}

function dots(letter) {
  if (!array()) return [];
  const bits = (BRAILLE.codePointAt(letter.charCodeAt(0) - 97) ?? 0x2800) - 0x2800;
  const [[x, y], pitch] = [cellCenter(), 2 * array().pitch_mm];
  const place = (dot) => [x + (Math.floor(dot / 3) - 0.5) * pitch, y + (1 - (dot % 3)) * pitch];
  return [0, 1, 2, 3, 4, 5].filter((dot) => (bits >> dot) & 1).map((dot) => [place(dot)]);
}

// A value as TOML, tables in one line.
function toml(value) {
  if (Array.isArray(value)) return `[${value.map(toml).join(", ")}]`;
  if (value === null || typeof value !== "object") return JSON.stringify(value);
  return `{ ${Object.entries(value).map(([key, of]) => `${key} = ${toml(of)}`).join(", ")} }`;
}

const file = (target) => Object.entries(target).map(([key, value]) => `${key} = ${toml(value)}\n`).join("");

export class Designer {
  #saved;
  #pad;
  #live;
  // The loaded target in full, to keep the keys that the page does not show.
  #loaded = null;
  #search = null;
  // The pattern that was found, and its details once they are known, by its SHA-256.
  #details = new Map();
  // Whether the pattern found plays automatically: only if the person has touched nothing since the pen was lifted.
  #atOnce = false;

  // `saved`: called when a pattern has been stored.
  constructor(saved) {
    this.#saved = saved;
    this.#pad = new Pad($("pad"), () => this.#drawn(), () => this.#lifted(), (text) => speak(text, "pad"));
    this.#live = new Live(() => this.#liveRequest(), () => this.#outline());
    const on = (id, event, run) => $(id).addEventListener(event, run);
    on("shape", "change", () => this.#choose());
    on("letter", "input", () => this.#drawn());
    on("points", "change", () => this.#typed());
    on("load", "change", () => this.#load($("load").value).then(() => say($("load"), ""), (error) => refuse($("load"), error)));
    on("undo", "click", () => this.#pad.undo());
    on("clear", "click", () => this.#pad.set([]));
    on("find", "click", () => this.#find(false));
    on("cancel", "click", () => this.#cancel());
    on("feel", "click", () => this.#feel());
    on("save-form", "submit", (event) => (event.preventDefault(), this.#save()));
    for (const event of ["pointerdown", "keydown"]) document.addEventListener(event, () => (this.#atOnce = false), { capture: true });
    document.addEventListener("array", () => this.#arrange());
    this.#choose();
    part({
      view: "design",
      at: "designer-title",
      load: () => this.#start(),
      on: { search: (event) => this.#handle(event) },
      hide: () => this.#live.end(),
    });
  }

  #arrange() {
    const { travel_um: most } = array().motor;
    $("amplitude").max = most;
    $("amplitude").value = Math.min($("amplitude").value || AMPLITUDE_UM, most);
    this.#drawn();
  }

  // The stored targets, and the search that the daemon knows.
  async #start() {
    await this.#list();
    const last = await call("GET", "/v1/searches/last").catch(() => null);
    // A restarted daemon counts from 1; an event may have come before the answer.
    if (!last) this.#search = null;
    else if (last.state !== "running" || last.id !== this.#search?.id) this.#show(last);
    this.#buttons();
  }

  // The details of a pattern that was found here.
  details(sha256) {
    return this.#details.get(sha256);
  }

  async #handle(event) {
    if (this.#search && event.id < this.#search.id) return;
    this.#show({ ...(this.#search?.id === event.id ? this.#search : {}), ...event });
    if (event.state !== "done") return;
    const atOnce = this.#atOnce && !document.hidden;
    this.#atOnce = false;
    if (atOnce) await this.#feel();
    this.#show(await call("GET", `/v1/searches/${event.id}`));
  }

  async #list() {
    const { targets } = await call("GET", "/v1/targets");
    const option = (text, value) => Object.assign(document.createElement("option"), { textContent: text, value });
    const kind = (target) => `${target.name} (${target.shape}${target.moves ? ", moves" : ""}${target.library ? "" : ", site"})`;
    $("load").replaceChildren(option(targets.length ? "Choose a target" : "No target is stored", ""), ...targets.map((target) => option(kind(target), target.name)));
    $("load").value = this.#loaded?.target.name ?? "";
    if (!$("load").value) $("load").value = "";
  }

  async #load(name) {
    if (!name) return;
    this.#loaded = await call("GET", `/v1/targets/${encodeURIComponent(name)}`);
    const { target } = this.#loaded;
    [$("reach").value, $("amplitude").value, $("target-name").value] = [target.reach_mm, target.amplitude_um, `${name}-new`.slice(0, 64)];
    if (DRAWN.includes(target.shape) && !target.motion) {
      $("shape").value = target.shape;
      this.#choose();
      this.#pad.set(target.points);
    } else {
      $("shape").value = "loaded";
      this.#choose();
    }
  }

  #choose() {
    const mode = $("shape").value;
    const drawn = DRAWN.includes(mode);
    this.#pad.mode = mode;
    $("letter-label").hidden = mode !== "braille";
    $("points-label").hidden = $("undo").hidden = $("clear").hidden = !drawn;
    if (drawn) this.#pad.set(this.#pad.points);
    else this.#drawn();
  }

  #typed() {
    const numbers = ($("points").value.match(/-?\d+(\.\d+)?/g) ?? []).map(Number);
    this.#pad.set(Array.from({ length: Math.floor(numbers.length / 2) }, (_, i) => numbers.slice(2 * i, 2 * i + 2)));
  }

  // Handles a change of the shape on the pad.
  #drawn() {
    $("points").value = this.#pad.points.map((point) => point.join(" ")).join("; ");
    this.#pad.show(DRAWN.includes($("shape").value) ? undefined : this.#outline());
    this.#buttons();
  }

  // The lines of the shape.
  #outline() {
    const mode = $("shape").value;
    const { points } = this.#pad;
    return { braille: dots($("letter").value || " "), loaded: this.#loaded?.outline ?? [], dots: points.map((point) => [point]) }[mode] ?? [points];
  }

  // A live play of the target; null without one, and for a target that moves by itself.
  #liveRequest() {
    const target = this.#target();
    return target && !target.motion ? { target, objective: $("objective").value, model: $("model").value } : null;
  }

  #lifted() {
    if ($("at-once").checked && !$("find").disabled) this.#find(true);
  }

  // The target as the daemon takes it; null if it is not complete.
  #target() {
    const mode = $("shape").value;
    const { points } = this.#pad;
    if (!array() || (mode === "loaded" && !this.#loaded)) return null;
    if ((DRAWN.includes(mode) && points.length < (mode === "dots" ? 1 : 2)) || (mode === "braille" && !/^[a-z]$/.test($("letter").value))) return null;
    const rest = mode === "loaded" ? this.#loaded.target : Object.fromEntries(Object.entries(this.#loaded?.target ?? {}).filter(([key]) => !SHAPE_KEYS.includes(key) && key !== "motion"));
    const shape = { loaded: {}, braille: { shape: mode, character: $("letter").value, center_mm: cellCenter() } }[mode] ?? { shape: mode, points };
    // A shape is one for any array; what is found for it is for this one.
    return { ...rest, name: $("target-name").value, array: array().name, ...shape, reach_mm: $("reach").valueAsNumber, amplitude_um: $("amplitude").valueAsNumber };
  }

  async #find(atOnce) {
    if (!valid("target-name", "reach", "amplitude", "budget")) return;
    const settings = { seconds: $("budget").valueAsNumber, objective: $("objective").value, model: $("model").value, robust: $("robust").checked };
    this.#atOnce = atOnce;
    try {
      const search = await call("POST", "/v1/searches", { target: this.#target(), ...settings });
      // Events that came before the answer may be newer.
      if (!this.#search || search.id > this.#search.id) this.#show(search);
      say($("find"), "");
    } catch (error) {
      this.#atOnce = false;
      refuse($("find"), error);
    }
  }

  async #cancel() {
    await call("DELETE", `/v1/searches/${this.#search.id}`).catch((error) => refuse($("cancel"), error));
  }

  async #feel() {
    if (!valid("feel-seconds")) return;
    const { id } = this.#search;
    try {
      // Its pins are shown while it plays.
      const known = call("GET", `/v1/patterns/search:${id}`).then((details) => this.#details.set(details.sha256, details), () => {});
      await order("/v1/play", { pattern: `search:${id}`, seconds: $("feel-seconds").valueAsNumber, replace: true });
      await known;
      say($("feel"), "");
    } catch (error) {
      refuse($("feel"), error);
    }
  }

  async #save() {
    const { result, target: old } = this.#search;
    const name = $("save-name").value;
    const query = $("replace").checked ? "?replace=true" : "";
    // The pattern has its target's name, and its provenance has it twice.
    const pattern = result.pattern.replace(/^(name|target) = "([a-z0-9-]+)"$/gm, (text, key, found) => (found === old ? `${key} = "${name}"` : text));
    try {
      await put(`/v1/patterns/${name}${query}`, pattern);
      await put(`/v1/targets/${name}${query}`, file({ ...result.definition, name }));
      say($("save"), `Saved pattern and target ${name}.`);
      this.#saved();
      await this.#list();
    } catch (error) {
      refuse($("save"), error);
    }
  }

  #show(search) {
    const before = this.#search;
    this.#search = search;
    const { progress, state, target } = search;
    const part = `${progress.evaluations} evaluations${progress.frames > 1 ? `, frame ${progress.frame} of ${progress.frames}` : ""}, ${progress.seconds.toFixed(1)} s`;
    $("search-progress").textContent = state === "running" ? part : "";
    $("search-busy").hidden = state !== "running";
    const isNew = before?.id !== search.id || before.state !== state;
    // Announce the result only once, when it is complete.
    if (state === "done" ? search.result && before?.result !== search.result : isNew) {
      const words = { running: `Searching for ${target} …`, cancelled: "Cancelled.", failed: `Failed: ${search.problem}`, done: `Found a pattern for ${target}: ${part}.` };
      $("search-note").textContent = words[state] + (search.result ? ` ${judge(search.result)}` : "");
    }
    if (state === "done" && isNew) $("save-name").value = target;
    if (search.result && search.result !== before?.result) this.#showResult(search.result);
    $("result").hidden = !search.result;
    this.#buttons();
  }

  #showResult(result) {
    const { figures: shown, legend } = maps(result);
    $("maps").replaceChildren(...shown);
    $("maps-note").textContent = legend;
    $("figures").tBodies[0].replaceChildren(...figures(result));
    $("result-warnings").textContent = result.warnings.join(" · ");
  }

  #buttons() {
    const running = this.#search?.state === "running";
    const done = this.#search?.state === "done";
    $("find").disabled = running || !this.#target();
    $("cancel").disabled = !running;
    $("feel").disabled = !done;
    $("save").disabled = !this.#search?.result;
    $("undo").disabled = $("clear").disabled = !this.#pad.points.length;
    this.#live.buttons();
  }
}

// Whether the search was worth it, in words.
function judge({ ended, value, value_naive_reach: reach, value_naive_pitch: pitch }) {
  const better = Math.max(reach, pitch) >= value;
  return `${ended === "limit" ? "The time is used up." : "Nothing improves any more."} ${better ? "A rule of thumb reaches as much without a search." : "By the objective it is better than both rules of thumb."}`;
}
