// The patterns: list, search, maps, play.

import { call, order } from "./api.js";
import { array } from "./array.js";
import { refuse, say, valid } from "./control.js";
import { thumbnail } from "./finger.js";
import { part } from "./views.js";

const $ = (id) => document.getElementById(id);

// Whether a pattern is for another array than the daemon's.
const isForeign = (pattern) => pattern.array !== array().name;

export class Patterns {
  #list = [];
  #details = new Map();
  // Fetches the list again.
  refresh;
  // Maps are fetched when they come into view, so that a long list costs little.
  #view = new IntersectionObserver((entries) => entries.forEach((entry) => entry.isIntersecting && this.#draw(entry.target)));

  constructor() {
    this.refresh = part({ view: "play", at: "patterns-title", load: () => this.#load() });
    $("search").addEventListener("input", () => this.#filter());
    document.addEventListener("array", () => ($("nearest").checked = false));
  }

  async #load() {
    const { patterns, errors } = await call("GET", "/v1/patterns");
    this.#list = patterns;
    this.#details.clear();
    $("pattern-errors").textContent = errors.join(" · ");
    $("nearest-label").hidden = !patterns.some(isForeign);
    this.#view.disconnect();
    $("pattern-list").replaceChildren(...patterns.map((pattern) => this.#item(pattern)));
    this.#filter();
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

  #item(pattern) {
    const item = document.createElement("li");
    item.dataset.name = pattern.name;
    const text = document.createElement("div");
    const length = pattern.duration_s === null ? "without end" : `${pattern.duration_s} s`;
    const reached = pattern.reached_max_um === null ? "no pin moves" : `${pattern.drives_moving} drives, up to ${pattern.reached_max_um.toFixed(0)} µm`;
    text.append(
      Object.assign(document.createElement("strong"), { textContent: pattern.name }),
      Object.assign(document.createElement("span"), { textContent: `${length}; ${reached}; ${pattern.library ? "library" : "site"}${isForeign(pattern) ? `; for the array ${pattern.array}` : ""}` }),
    );
    const map = Object.assign(document.createElement("div"), { className: "map" });
    const play = Object.assign(document.createElement("button"), { textContent: "Play" });
    play.setAttribute("aria-label", `Play ${pattern.name}`);
    play.dataset.needs = "operate";
    play.addEventListener("click", () => this.#play(pattern, play));
    item.append(map, text, play);
    // Where the pins of another array stand is not known here.
    if (!isForeign(pattern)) this.#view.observe(item);
    return item;
  }

  #draw(item) {
    this.#view.unobserve(item);
    this.details(item.dataset.name).then((details) => item.querySelector(".map").replaceChildren(thumbnail(details)), () => {});
  }

  #filter() {
    const words = $("search").value.toLowerCase().split(/\s+/);
    const items = [...$("pattern-list").children];
    for (const item of items) item.hidden = !words.every((word) => item.dataset.name.includes(word));
    $("pattern-none").hidden = items.some((item) => !item.hidden);
    $("pattern-none").textContent = items.length ? "No pattern has this in its name." : "No pattern is stored.";
  }

  async #play(pattern, button) {
    if (!valid("seconds", "scale")) return;
    const map = isForeign(pattern) ? { map: "nearest" } : {};
    try {
      if (map.map && !$("nearest").checked) throw new Error(`${pattern.name} is for the array ${pattern.array}, and this one is ${array().name}. To play it all the same, tick “Play patterns for other arrays by position”.`);
      await order("/v1/play", { pattern: pattern.name, seconds: $("seconds").valueAsNumber, scale: $("scale").valueAsNumber, ...map });
      say(button, "");
    } catch (error) {
      refuse(button, error);
    }
  }
}
