// The patterns: list, search, maps, play. A person chooses one for its details, and a second one to compare.

import { call, order } from "./api.js";
import { Chosen } from "./chosen.js";
import { element, operates, refuse, say, valid } from "./control.js";
import { thumbnail } from "./finger.js";
import { isForeign, mapping } from "./foreign.js";
import { part } from "./views.js";

const $ = (id) => document.getElementById(id);
// Items that are built at once. The others are empty until they come into view, so that a list of thousands costs little.
const AT_ONCE = 100;

export class Patterns {
  #details = new Map();
  #byName = new Map();
  #chosen = new Chosen((name) => this.details(name), () => this.refresh(), () => this.#mark());
  // Fetches the list again.
  refresh;
  // Maps are fetched when they come into view.
  #view = new IntersectionObserver((entries) => entries.forEach((entry) => entry.isIntersecting && this.#draw(entry.target)), { rootMargin: "300px" });

  constructor() {
    this.refresh = part({ view: "play", at: "patterns-title", load: () => this.#load() });
    $("search").addEventListener("input", () => this.#filter());
    document.addEventListener("array", () => ($("nearest").checked = false));
  }

  async #load() {
    const { patterns, errors } = await call("GET", "/v1/patterns");
    this.#byName = new Map(patterns.map((pattern) => [pattern.name, pattern]));
    this.#details.clear();
    $("pattern-errors").textContent = errors.join(" · ");
    $("nearest-label").hidden = !patterns.some(isForeign);
    this.#view.disconnect();
    $("pattern-list").replaceChildren(...patterns.map(({ name }, i) => {
      const item = document.createElement("li");
      item.dataset.name = name;
      if (i < AT_ONCE) this.#build(item);
      this.#view.observe(item);
      return item;
    }));
    this.#filter();
    this.#chosen.renew(this.#byName);
    this.#mark();
  }

  // A pattern in full, fetched once.
  details(name) {
    if (!this.#details.has(name)) {
      const fetched = call("GET", `/v1/patterns/${encodeURIComponent(name)}`);
      this.#details.set(name, fetched);
      fetched.catch(() => this.#details.delete(name));
    }
    return this.#details.get(name);
  }

  #build(item) {
    const pattern = this.#byName.get(item.dataset.name);
    const length = pattern.duration_s === null ? "without end" : `${pattern.duration_s} s`;
    const drives = pattern.drives_moving ? `${pattern.drives_moving} drives, up to ${pattern.reached_max_um.toFixed(0)} µm` : "";
    const moves = [drives, pattern.motions ? `${pattern.motions} motions` : ""].filter(Boolean).join(", ") || "no pin moves";
    const play = operates(element("button", "Play", { type: "button", ariaLabel: `Play ${pattern.name}` }));
    play.addEventListener("click", () => this.#play(pattern, play));
    const choose = element("button", "", { type: "button", className: "choose" });
    choose.append(
      element("strong", pattern.name),
      element("span", `${length}; ${moves}; ${pattern.library ? "library" : "site"}${isForeign(pattern) ? `; for the array ${pattern.array}` : ""}`),
    );
    choose.addEventListener("click", () => this.#chosen.choose(pattern));
    const compare = element("button", "Compare", { type: "button", className: "compare", ariaLabel: `Compare with ${pattern.name}` });
    compare.addEventListener("click", () => this.#chosen.compare(pattern));
    item.append(play, element("div", "", { className: "map" }), choose, compare);
    this.#markItem(item);
  }

  #draw(item) {
    this.#view.unobserve(item);
    if (!item.firstChild) this.#build(item);
    // Where the pins of another array stand is not known here.
    if (isForeign(this.#byName.get(item.dataset.name))) return;
    this.details(item.dataset.name).then((details) => item.querySelector(".map").replaceChildren(thumbnail(details)), () => {});
  }

  #filter() {
    const words = $("search").value.toLowerCase().split(/\s+/);
    const items = [...$("pattern-list").children];
    for (const item of items) item.hidden = !words.every((word) => item.dataset.name.includes(word));
    $("pattern-none").hidden = items.some((item) => !item.hidden);
    $("pattern-none").textContent = items.length ? "No pattern has this in its name." : "No pattern is stored.";
  }

  // Marks the chosen pattern, and the one beside it.
  #mark() {
    $("pattern-list").classList.toggle("has-chosen", this.#chosen.names[0] !== null);
    for (const item of $("pattern-list").children) this.#markItem(item);
  }

  #markItem(item) {
    const [chosen, beside] = this.#chosen.names.map((name) => name === item.dataset.name);
    item.classList.toggle("chosen", chosen);
    item.querySelector(".choose")?.setAttribute("aria-pressed", chosen);
    item.querySelector(".compare")?.setAttribute("aria-pressed", beside);
  }

  async #play(pattern, button) {
    if (!valid("seconds", "scale")) return;
    try {
      await order("/v1/play", { pattern: pattern.name, seconds: $("seconds").valueAsNumber, scale: $("scale").valueAsNumber, ...mapping(pattern) });
      say(button, "");
    } catch (error) {
      refuse(button, error);
    }
  }
}
