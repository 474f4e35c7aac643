// The rendering of the drawn thing: the page asks the daemon for it, plays it as soon as it is found, and shows how near it comes once it is
// judged. One rendering runs at a time: a newer one cancels the one before.

import { call, known, last, order, put } from "./api.js";
import { rasters, responses, rows } from "./compare.js";
import { $, orders, refuse, say, speak } from "./control.js";
import { sentence } from "./words.js";

// So often another rendering that runs is cancelled and this one asked for again.
const TRIES = 5;
// A rendering with a file of some megabytes takes a while to send.
const SEND_MS = 60000;

export class Rendering {
  // The newest request that was not sent yet: its body, and whether to play what is found.
  #wanted = null;
  #isAsking = false;
  // The rendering as the daemon shows it, without a result until it is judged.
  #rendering = null;
  // Events that came before the answer which says whose they are.
  #early = new Map();
  #atOnce = false;
  #shown = null;
  #changed;
  // Plays what was found.
  #feel;
  #clock = 0;
  // When it was asked for.
  #begun = 0;

  // `changed`: called when another pattern is found, or is no more.
  constructor(changed) {
    this.#changed = changed;
    for (const event of ["pointerdown", "keydown"]) document.addEventListener(event, () => (this.#atOnce = false), { capture: true });
    this.#feel = orders($("thing-feel"), () => order("/v1/play", { pattern: `rendering:${this.#rendering.id}`, replace: true }), () => {});
    $("thing-cancel").addEventListener("click", () => {
      this.#wanted = null;
      if (this.#rendering?.state === "running") this.#cancel(this.#rendering.id);
    });
    this.#show();
  }

  // What must be kept to show the result again after a reload; null without one.
  get kept() {
    return this.#rendering?.rendered ? { id: this.#rendering.id, sha256: this.#rendering.rendered.sha256 } : null;
  }

  // Whether a request is on its way.
  get isAsking() {
    return this.#isAsking;
  }

  // Whether a rendering of the drawing was asked for.
  get isAsked() {
    return this.#isAsking || this.#rendering !== null;
  }

  // Whether a rendering of the daemon is this one.
  isMine(id) {
    return this.#rendering?.id === id;
  }

  // Asks for a rendering; `feel`: and plays it if the person touches nothing meanwhile. Null: there is nothing to render.
  ask(body, feel) {
    this.#wanted = body && { body, feel };
    if (!body) this.#forget();
    else if (!this.#isAsking) this.#askAll();
  }

  // Shows a rendering of before, if the daemon has it still. Returns whether it has.
  async resume({ id, sha256 } = this.kept ?? this.#rendering ?? {}) {
    // A daemon that was restarted counts from 1.
    if (id === undefined || !(id <= last()?.newest.rendering)) return false;
    const rendering = await call("GET", `/v1/renderings/${id}`).catch(({ code }) => (code === "not-found" ? null : undefined));
    if (rendering === undefined || this.#isAsking || (this.#rendering && this.#rendering.id !== id)) return true;
    if (!rendering || (sha256 && rendering.rendered?.sha256 !== sha256) || !["running", "done"].includes(rendering.state)) return false;
    this.#take(rendering, false);
    return true;
  }

  // An event of the daemon about a rendering.
  async handle(event) {
    if (!this.isMine(event.id)) {
      if (this.#isAsking) this.#early.set(event.id, event);
      return;
    }
    const hadFound = this.#rendering.found;
    this.#rendering = { ...this.#rendering, ...event };
    if (event.found && !hadFound) this.#found();
    this.#show();
    if (event.state === "done") await this.#judged(event.id);
  }

  async #judged(id) {
    const rendering = await call("GET", `/v1/renderings/${id}`);
    if (this.isMine(id)) this.#take(rendering, true);
  }

  #take(rendering, isNew) {
    this.#rendering = rendering;
    this.#show();
    if (isNew && rendering.rendered) speak(`Found a pattern for ${rendering.object}.`, "rendering");
    this.#changed();
  }

  #forget() {
    if (this.#rendering?.state === "running") this.#cancel(this.#rendering.id);
    this.#rendering = null;
    this.#show();
    this.#changed();
  }

  #cancel(id) {
    return call("DELETE", `/v1/renderings/${id}`).catch(() => {});
  }

  async #askAll() {
    this.#isAsking = true;
    while (this.#wanted) {
      const wanted = this.#wanted;
      this.#wanted = null;
      if (this.#rendering?.state === "running") await this.#cancel(this.#rendering.id);
      this.#rendering = null;
      this.#early.clear();
      this.#begun = performance.now();
      this.#show(true);
      try {
        const rendering = await this.#post(wanted);
        if (rendering) this.#begin(rendering, wanted.feel);
      } catch (error) {
        this.#show();
        refuse($("thing-feel"), error);
      }
    }
    this.#isAsking = false;
  }

  #begin(rendering, feel) {
    this.#atOnce = feel;
    say($("thing-feel"), "");
    this.#rendering = rendering;
    this.#show();
    const early = this.#early.get(rendering.id);
    if (early) this.handle(early).catch((error) => refuse($("thing-feel"), error));
  }

  // Null if a newer one is wanted by now.
  async #post(wanted) {
    for (let tries = 1; !this.#wanted; tries++) {
      try {
        return await call("POST", "/v1/renderings", wanted.body, SEND_MS);
      } catch (error) {
        if (error.code !== "rendering-running" || tries === TRIES) throw error;
      }
      const other = await call("GET", "/v1/renderings/last");
      if (other.state === "running") await this.#cancel(other.id);
    }
    return null;
  }

  #found() {
    this.#changed();
    const atOnce = this.#atOnce && !document.hidden;
    this.#atOnce = false;
    if (atOnce) this.#feel();
  }

  // Says so when it is not known whether the rendering goes on.
  doubt() {
    if (this.#rendering?.state !== "running" || known()) return;
    $("thing-note").textContent = "Whether the rendering goes on is not known.";
    $("thing-busy").hidden = $("thing-cancel").hidden = true;
  }

  // What was found and judged, to be saved; null without it.
  get result() {
    return this.#rendering?.rendered ? this.#rendering : null;
  }

  // Stores the pattern of a result under a name. Throws what the daemon says against it.
  async save({ rendered, object }, name, replace) {
    const text = rendered.pattern.replace(/^name = "([a-z0-9-]+)"$/gm, (line, old) => (old === object ? `name = "${name}"` : line));
    await put(`/v1/patterns/${name}${replace ? "?replace=true" : ""}`, text);
  }

  // Shows the rendering. `isAsked`: it is on its way to the daemon.
  #show(isAsked = false) {
    const { state, found, rendered, problem, object, method } = this.#rendering ?? {};
    const isRunning = isAsked || state === "running";
    const since = `${((performance.now() - this.#begun) / 1000).toFixed(0)} s`;
    const words = { running: found ? `Found a pattern for ${object}. Judging it, ${since} …` : `Rendering ${object}, ${since} …`, failed: `Failed: ${sentence(problem ?? "")}`, cancelled: "Cancelled." };
    $("thing-note").textContent = isAsked ? "Rendering …" : (words[state] ?? "");
    $("thing-busy").hidden = $("thing-cancel").hidden = !isRunning;
    clearTimeout(this.#clock);
    if (state === "running") this.#clock = setTimeout(() => this.#rendering?.state === "running" && known() && this.#show(), 1000);
    $("thing-feel").disabled = !found;
    $("thing-save").disabled = !rendered;
    // An older result stays in sight, paler, until there is a new one.
    $("thing-result").hidden = !(rendered || (isRunning && this.#shown));
    $("thing-result").classList.toggle("older", !rendered);
    if (!rendered || rendered === this.#shown) {
      if (!isRunning) this.#shown = rendered ?? null;
      return;
    }
    this.#shown = rendered;
    $("thing-facts").textContent = `${rendered.duration_s.toFixed(2)} s, pins up to ${rendered.highest_um.toFixed(0)} µm, method ${method}.`;
    $("thing-maps").replaceChildren(...responses(rendered));
    $("thing-rasters").replaceChildren(...rasters(rendered));
    $("thing-figures").tBodies[0].replaceChildren(...rows(rendered.judged));
    $("thing-warnings").textContent = rendered.warnings.map(sentence).join(" ");
  }
}
