// The rendering of the drawn thing: the page asks the daemon for it, plays it as soon as it is found, and shows how near it comes once it is
// judged. One rendering runs at a time: a newer one cancels the one before.

import { call, known, last, order, put } from "./api.js";
import { rasters, responses, rows, verdict } from "./compare.js";
import { orders, refuse, say, speak } from "./control.js";
import { plain } from "./words.js";

const $ = (id) => document.getElementById(id);
// So often a search that runs is cancelled and the rendering asked for again.
const TRIES = 5;
// A rendering with a file of some megabytes takes a while to send.
const SEND_MS = 60000;

export class Rendering {
  // The newest request that was not sent yet: its body, and whether to play what is found.
  #wanted = null;
  #isAsking = false;
  // The rendering as the daemon shows it, without a result until it is judged.
  #search = null;
  // Events that came before the answer which says whose they are.
  #early = new Map();
  #atOnce = false;
  #shown = null;
  // The search that is in the way, and the request that waits for it.
  #blocked = null;
  #changed;
  // Plays what was found.
  #feel;

  // `changed`: called when another pattern is found, or is no more.
  constructor(changed) {
    this.#changed = changed;
    for (const event of ["pointerdown", "keydown"]) document.addEventListener(event, () => (this.#atOnce = false), { capture: true });
    this.#feel = orders($("thing-feel"), () => order("/v1/play", { pattern: `search:${this.#search.id}`, replace: true }).then(() => ""));
    $("thing-cancel").addEventListener("click", () => this.#goOn());
    this.#show();
  }

  // What must be kept to show the result again after a reload; null without one.
  get kept() {
    return this.#search?.rendered ? { id: this.#search.id, sha256: this.#search.rendered.sha256 } : null;
  }

  // Whether a request is on its way.
  get isAsking() {
    return this.#isAsking;
  }

  // Whether a rendering of the drawing was asked for.
  get isAsked() {
    return this.#isAsking || this.#search !== null;
  }

  // Whether a search of the daemon is this rendering.
  isMine(id) {
    return this.#search?.id === id;
  }

  // Asks for a rendering; `feel`: and plays it if the person touches nothing meanwhile. Null: there is nothing to render.
  ask(body, feel) {
    this.#wanted = body && { body, feel };
    $("thing-blocked").hidden = true;
    if (!body) this.#forget();
    else if (!this.#isAsking) this.#askAll();
  }

  // Shows a rendering of before, if the daemon has it still. Returns whether it has.
  async resume({ id, sha256 } = this.kept ?? this.#search ?? {}) {
    // A daemon that was restarted counts from 1.
    if (id === undefined || !(id <= last()?.last_search)) return false;
    const search = await call("GET", `/v1/searches/${id}`).catch(({ code }) => (code === "not-found" ? null : undefined));
    if (search === undefined || this.#isAsking || (this.#search && this.#search.id !== id)) return true;
    if (!search || search.method === null || (sha256 && search.rendered?.sha256 !== sha256) || !["running", "done"].includes(search.state)) return false;
    this.#take(search, false);
    return true;
  }

  // An event of the daemon about a search.
  async handle(event) {
    if (!this.isMine(event.id)) {
      if (this.#isAsking) this.#early.set(event.id, event);
      return;
    }
    const hadFound = this.#search.found;
    this.#search = { ...this.#search, ...event };
    if (event.found && !hadFound) this.#found();
    this.#show();
    if (event.state === "done") await this.#judged(event.id);
  }

  async #judged(id) {
    const search = await call("GET", `/v1/searches/${id}`);
    if (this.isMine(id)) this.#take(search, true);
  }

  #take(search, isNew) {
    this.#search = search;
    this.#show();
    if (isNew && search.rendered) speak(`Found a pattern for ${search.target}. ${$("thing-verdict").textContent}`, "rendering");
    this.#changed();
  }

  #forget() {
    if (this.#search?.state === "running") this.#cancel(this.#search.id);
    this.#search = null;
    this.#show();
    this.#changed();
  }

  #cancel(id) {
    return call("DELETE", `/v1/searches/${id}`).catch(() => {});
  }

  async #askAll() {
    this.#isAsking = true;
    while (this.#wanted) {
      const wanted = this.#wanted;
      this.#wanted = null;
      if (this.#search?.state === "running") await this.#cancel(this.#search.id);
      this.#search = null;
      this.#early.clear();
      this.#show(true);
      try {
        const search = await this.#post(wanted);
        if (search) this.#begin(search, wanted.feel);
      } catch (error) {
        this.#show();
        refuse($("thing-feel"), error);
      }
    }
    this.#isAsking = false;
  }

  #begin(search, feel) {
    this.#atOnce = feel;
    say($("thing-feel"), "");
    this.#search = search;
    this.#show();
    const early = this.#early.get(search.id);
    if (early) this.handle(early).catch((error) => refuse($("thing-feel"), error));
  }

  // Null if a newer one is wanted by now, or if a search runs that only the person may cancel.
  async #post(wanted) {
    for (let tries = 1; !this.#wanted; tries++) {
      try {
        return await call("POST", "/v1/searches", wanted.body, SEND_MS);
      } catch (error) {
        if (error.code !== "search-running" || tries === TRIES) throw error;
      }
      const other = await call("GET", "/v1/searches/last");
      // A rendering takes a second or two. A search may have taken minutes.
      if (other.state === "running" && other.method === null) {
        this.#block(other, wanted);
        return null;
      }
      if (other.state === "running") await this.#cancel(other.id);
    }
    return null;
  }

  // Asks whether to cancel a search.
  #block(other, wanted) {
    this.#show();
    $("thing-blocked").hidden = false;
    $("thing-blocked-text").textContent = `A search for ${other.target} runs, so nothing was rendered.`;
    speak($("thing-blocked-text").textContent, "rendering");
    this.#blocked = { id: other.id, wanted };
  }

  async #goOn() {
    const { id, wanted } = this.#blocked;
    await this.#cancel(id);
    this.ask(wanted.body, false);
  }

  #found() {
    this.#changed();
    const atOnce = this.#atOnce && !document.hidden;
    this.#atOnce = false;
    if (atOnce) this.#feel();
  }

  // Says so when it is not known whether the rendering goes on.
  doubt() {
    if (this.#search?.state !== "running" || known()) return;
    $("thing-note").textContent = "Whether the rendering goes on is not known.";
    $("thing-busy").hidden = true;
  }

  // What was found and judged, to be saved; null without it.
  get result() {
    return this.#search?.rendered ? this.#search : null;
  }

  // Stores the pattern of a result under a name. Throws what the daemon says against it.
  async save({ rendered, target }, name, replace) {
    const text = rendered.pattern.replace(/^name = "([a-z0-9-]+)"$/gm, (line, old) => (old === target ? `name = "${name}"` : line));
    await put(`/v1/patterns/${name}${replace ? "?replace=true" : ""}`, text);
  }

  // Shows the rendering. `isAsked`: it is on its way to the daemon.
  #show(isAsked = false) {
    const { state, found, rendered, problem, target, method } = this.#search ?? {};
    const isRunning = isAsked || state === "running";
    const words = { running: found ? `Found a pattern for ${target}. Judging it …` : `Rendering ${target} …`, failed: `Failed: ${plain(problem ?? "")}`, cancelled: "Cancelled." };
    $("thing-note").textContent = isAsked ? "Rendering …" : (words[state] ?? "");
    $("thing-busy").hidden = !isRunning;
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
    $("thing-verdict").textContent = verdict(rendered.judged).join("\n");
    $("thing-facts").textContent = `${rendered.duration_s.toFixed(2)} s, pins up to ${rendered.highest_um.toFixed(0)} µm, method ${method}. In brackets: the same of the other pattern.`;
    $("thing-maps").replaceChildren(...responses(rendered));
    $("thing-rasters").replaceChildren(...rasters(rendered));
    $("thing-figures").tBodies[0].replaceChildren(...rows(rendered.judged));
    $("thing-warnings").textContent = rendered.warnings.map((line) => plain(line)).join(" ");
  }
}
