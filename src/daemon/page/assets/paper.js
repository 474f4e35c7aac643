// The paper's search: for the drawn shape, or a loaded target, the daemon searches for a vibration whose afferents near the shape fire and
// the others do not. The page shows, plays and saves what is found.

import { call, known, last, order, put } from "./api.js";
import { array } from "./array.js";
import { orders, refuse, say } from "./control.js";
import { Live } from "./live.js";
import { figures, maps } from "./maps.js";
import { number, right } from "./number.js";
import { drawn, target } from "./thing.js";
import { plain } from "./words.js";

const $ = (id) => document.getElementById(id);
// The amplitude of a new target, if the motors go so far, µm.
const AMPLITUDE_UM = 80;
const SHAPE_KEYS = ["name", "shape", "points", "center_mm", "radius_mm", "character", "dot_pitch_mm", "period_mm", "angle_deg", "offset_mm", "reach_mm", "amplitude_um"];

// A value as TOML, tables in one line.
function toml(value) {
  if (Array.isArray(value)) return `[${value.map(toml).join(", ")}]`;
  if (value === null || typeof value !== "object") return JSON.stringify(value);
  return `{ ${Object.entries(value).map(([key, of]) => `${key} = ${toml(of)}`).join(", ")} }`;
}

const file = (target) => Object.entries(target).map(([key, value]) => `${key} = ${toml(value)}\n`).join("");

export class Paper {
  #doc;
  #saved;
  #live;
  #search = null;
  // Whether the pattern found plays automatically: only if the person has touched nothing since the pen was lifted.
  #atOnce = false;
  // Plays what was found.
  #feel;

  // `doc`: the drawing. `pad`: where it is drawn. `changed`: called when the pad is taken or free. `saved`: called when a pattern and a target
  // have been stored.
  constructor({ doc, pad, changed, saved }) {
    [this.#doc, this.#saved] = [doc, saved];
    this.#live = new Live({ pad, id: "live", request: () => this.#liveRequest(), check: () => right("target-name", "reach", "amplitude"), thing: () => drawn(doc()), changed });
    const on = (id, event, run) => $(id).addEventListener(event, run);
    on("find", "click", () => this.find(false));
    on("cancel", "click", () => this.#cancel());
    this.#feel = orders($("feel"), () => this.#play());
    on("save-form", "submit", (event) => (event.preventDefault(), this.#save()));
    for (const event of ["pointerdown", "keydown"]) document.addEventListener(event, () => (this.#atOnce = false), { capture: true });
  }

  arrange() {
    const { travel_um: most } = array().motor;
    $("amplitude").max = most;
    $("amplitude").value = Math.min($("amplitude").value || AMPLITUDE_UM, most);
  }

  // Takes the numbers of a loaded target.
  loaded({ name, reach_mm, amplitude_um }) {
    [$("reach").value, $("amplitude").value, $("target-name").value] = [reach_mm, amplitude_um, `${name}-new`.slice(0, 64)];
  }

  // The search that the daemon knows.
  async start() {
    const newest = last()?.last_search;
    const search = newest ? await call("GET", `/v1/searches/${newest}`).catch(absent) : null;
    // A restarted daemon counts from 1; an event may have come before the answer.
    if (!search) this.#forget();
    else if (search.method === null && (search.state !== "running" || search.id !== this.#search?.id)) this.#show(search);
  }

  // Says so when it is not known whether the search goes on.
  doubt() {
    if (this.#search?.state !== "running" || known()) return;
    $("search-progress").textContent = "Whether the search goes on is not known.";
    $("search-busy").hidden = true;
  }

  end() {
    this.#live.end();
  }

  // The daemon was started again, and has no search.
  #forget() {
    if (!this.#search) return;
    this.#search = null;
    $("search-note").textContent = "The daemon was started again: the search and what it found are gone.";
    $("search-progress").textContent = "";
    $("search-busy").hidden = $("result").hidden = true;
    this.buttons();
  }

  async handle(event) {
    if (this.#search && event.id < this.#search.id) return;
    if (this.#search?.id !== event.id) {
      // An event does not say whether it is that of a rendering.
      const search = await call("GET", `/v1/searches/${event.id}`);
      if (search.method !== null || event.id < this.#search?.id) return;
    }
    this.#show({ ...(this.#search?.id === event.id ? this.#search : {}), ...event });
    if (event.state !== "done") return;
    const atOnce = this.#atOnce && !document.hidden;
    this.#atOnce = false;
    if (atOnce) await this.#feel();
    this.#show(await call("GET", `/v1/searches/${event.id}`));
  }

  // A live play of the target; null without one, and for a target that moves by itself.
  #liveRequest() {
    const target = this.#target();
    return target && !target.motion ? { target, objective: $("objective").value, model: $("model").value } : null;
  }

  // The target as the daemon takes it; null if it is not complete, or a number is wrong.
  #target() {
    const doc = this.#doc();
    const [shape] = target(doc);
    if (!array() || !shape) return null;
    const of = doc.loaded?.target ?? {};
    const rest = doc.shape === "loaded" ? of : Object.fromEntries(Object.entries(of).filter(([key]) => !SHAPE_KEYS.includes(key) && key !== "motion"));
    // A shape is one for any array; what is found for it is for this one.
    return { ...rest, name: $("target-name").value, array: array().name, ...shape, reach_mm: number("reach"), amplitude_um: number("amplitude") };
  }

  // Searches; `atOnce`: and plays what is found.
  async find(atOnce) {
    if ($("find").disabled || !right("target-name", "reach", "amplitude", "budget")) return;
    const settings = { seconds: number("budget"), objective: $("objective").value, model: $("model").value, robust: $("robust").checked };
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

  async #play() {
    if (right("feel-seconds")) await order("/v1/play", { pattern: `search:${this.#search.id}`, seconds: number("feel-seconds"), replace: true });
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
      await this.#saved();
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
      const words = { running: `Searching for ${target} …`, cancelled: "Cancelled.", failed: `Failed: ${plain(search.problem ?? "")}`, done: `Found a pattern for ${target}: ${part}.` };
      $("search-note").textContent = words[state] + (search.result ? ` ${judge(search.result, search.objective)}` : "");
    }
    if (state === "done" && isNew) $("save-name").value = target;
    if (search.result && search.result !== before?.result) this.#showResult(search.result);
    $("result").hidden = !search.result;
    this.buttons();
  }

  #showResult(result) {
    const { figures: shown, legend } = maps(result);
    $("maps").replaceChildren(...shown);
    $("maps-note").textContent = legend;
    $("figures").tBodies[0].replaceChildren(...figures(result));
    $("result-warnings").textContent = result.warnings.map((line) => plain(line)).join(" ");
  }

  buttons() {
    const running = this.#search?.state === "running";
    $("find").disabled = running || !this.#target();
    $("cancel").disabled = !running;
    $("feel").disabled = this.#search?.state !== "done";
    $("save").disabled = !this.#search?.result;
    $("target-why").textContent = target(this.#doc())[1];
    this.#live.buttons();
  }
}

// Nothing, of a search that the daemon does not have.
function absent(error) {
  if (error.code !== "not-found") throw error;
  return null;
}

// Whether the search was worth it, by what it has searched for, in words.
function judge({ ended, value, value_naive_reach: reach, value_naive_pitch: pitch }, objective) {
  const rule = Math.max(reach, pitch);
  const of = `${value.toPrecision(3)} against ${rule.toPrecision(3)} of the better rule of thumb`;
  const verdict = rule >= value ? "A rule of thumb reaches as much without a search" : "It is better than both rules of thumb";
  return `${ended === "limit" ? "The time is used up." : "Nothing improves any more."} ${verdict}, by the objective “${objective}”: ${of}.`;
}
