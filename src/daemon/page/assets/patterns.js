// The patterns: list, search, maps, play. A person chooses one for its details.
//
// Others may store, replace and remove patterns meanwhile, and no event tells of it. So the list is fetched whenever it comes into sight, and
// a pattern plays only if the daemon still has the one that is drawn.

import { call, order } from "./api.js";
import { checkArray, isForeign } from "./array.js";
import { Chosen } from "./chosen.js";
import { $, element, operates, orders, refuse } from "./control.js";
import { thumbnail } from "./pins.js";
import { number, optional, right } from "./number.js";
import { part } from "./views.js";

// Patterns that are listed, at most; the search finds the others.
const LISTED = 200;

// Where a pattern is stored, as the list shows it and as the search finds it.
const where = ({ library }) => (library ? "library" : "site");
const key = ({ name, sha256 }) => `${name} ${sha256}`;
// The pattern that the daemon has under a name, in full.
const stored = (name) => call("GET", `/v1/patterns/${encodeURIComponent(name)}`);

export class Patterns {
  // By name and SHA-256.
  #details = new Map();
  #byName = new Map();
  // What was listed, by name: its item of the list, and `of`, the pattern as it was built.
  #items = new Map();
  // Lists that were asked for: an older one shows nothing.
  #asked = 0;
  #chosen = new Chosen({
    details: (pattern) => this.details(pattern), check: (pattern) => this.#check(pattern), stored: () => this.refresh(), marked: () => this.#mark(),
  });
  // Fetches the list again.
  refresh;
  // Maps are fetched when they come into view.
  #view = new IntersectionObserver((entries) => entries.forEach((entry) => entry.isIntersecting && this.#draw(entry.target)), { rootMargin: "300px" });

  constructor() {
    this.refresh = part({ view: "play", at: "patterns-title", load: () => this.#load(), again: true });
    $("search").addEventListener("input", () => this.#list());
    document.addEventListener("array", () => {
      // What a pattern is for, and what it reaches, depends on the array.
      $("pattern-list").replaceChildren();
      this.#items.clear();
      this.#details.clear();
    });
  }

  async #load() {
    const asked = ++this.#asked;
    const { patterns: all, errors } = await call("GET", "/v1/patterns");
    if (asked !== this.#asked) return;
    // Those of this site come first.
    const patterns = [...all.filter(({ library }) => !library), ...all.filter(({ library }) => library)];
    this.#byName = new Map(patterns.map((pattern) => [pattern.name, pattern]));
    const keys = new Set(patterns.map(key));
    for (const old of this.#details.keys()) if (!keys.has(old)) this.#details.delete(old);
    for (const old of this.#items.keys()) if (!this.#byName.has(old)) this.#items.delete(old);
    $("pattern-errors").textContent = errors.join(" · ");
    this.#list();
    this.#chosen.renew(this.#byName);
    this.#mark();
  }

  // Shows the patterns that the search finds. What is listed as it was stays the same item, with what it said.
  #list() {
    const words = $("search").value.toLowerCase().split(/\s+/);
    const found = [...this.#byName.values()].filter((pattern) => words.every((word) => `${pattern.name} ${where(pattern)}`.includes(word)));
    const list = $("pattern-list");
    const items = found.slice(0, LISTED).map((pattern) => this.#item(pattern));
    $("pattern-none").textContent = found.length > LISTED ? `The first ${LISTED} of ${found.length}: search for others.` : found.length ? "" : this.#byName.size ? "No pattern fits the search." : "No pattern is stored.";
    $("pattern-none").hidden = found.length > 0 && found.length <= LISTED;
    if (items.length === list.children.length && items.every((item, i) => item === list.children[i])) return;
    const [focus, top] = [document.activeElement, list.scrollTop];
    list.replaceChildren(...items);
    list.scrollTop = top;
    if (list.contains(focus)) focus.focus({ preventScroll: true });
  }

  #item(pattern) {
    const { item, of: before } = this.#items.get(pattern.name) ?? { item: element("li") };
    const of = JSON.stringify(pattern);
    this.#items.set(pattern.name, { item, of });
    item.dataset.name = pattern.name;
    if (of !== before) this.#build(item);
    // Also one whose map could not be fetched.
    if (!item.querySelector(".map > *")) this.#view.observe(item);
    return item;
  }

  // A pattern of the list in full, fetched once. If the daemon has another one by now, the list is fetched again.
  details(pattern) {
    if (!this.#details.has(key(pattern))) {
      const fetched = stored(pattern.name).then((full) => {
        if (full.sha256 !== pattern.sha256) this.refresh();
        return full;
      });
      this.#details.set(key(pattern), fetched);
      fetched.catch(() => this.#details.delete(key(pattern)));
    }
    return this.#details.get(key(pattern));
  }

  // Makes sure that the daemon has the pattern that the page shows. If not, it shows what there is, and throws.
  async #check({ name, sha256 }) {
    const now = await stored(name).catch((error) => {
      if (error.code !== "not-found") throw error;
      return null;
    });
    if (now?.sha256 === sha256) return;
    await this.refresh();
    throw new Error(now ? `“${name}” was replaced by another pattern, which the page shows now. Look at it, then press again.` : `“${name}” was removed meanwhile.`);
  }

  // Fills an item; its button to play, and what it said, stay.
  #build(item) {
    const { name } = item.dataset;
    const pattern = this.#byName.get(name);
    const length = pattern.duration_s === null ? "without end" : `${pattern.duration_s} s`;
    const moves = [pattern.drives_moving ? `${pattern.drives_moving} drives` : "", pattern.motions ? `${pattern.motions} motions` : ""].filter(Boolean).join(", ");
    const reach = moves ? `${moves}, up to ${pattern.highest_um.toFixed(0)} µm` : "no pin moves";
    const choose = element("button", "", { type: "button", className: "choose" });
    choose.append(
      element("strong", name),
      element("span", `${length}; ${reach}; ${where(pattern)}${isForeign(pattern) ? `; for the array ${pattern.array}` : ""}`),
    );
    choose.addEventListener("click", () => this.#chosen.choose(pattern));
    const [play, said] = ["button", ".say"].map((part) => item.querySelector(`:scope > ${part}`));
    item.replaceChildren(play ?? this.#player(name), element("div", "", { className: "map" }), choose, ...(said ? [said] : []));
    this.#markItem(item);
  }

  #player(name) {
    const play = operates(element("button", "Play", { type: "button", ariaLabel: `Play ${name}` }));
    orders(play, () => this.#play(this.#byName.get(name)), () => this.#ready(this.#byName.get(name)));
    return play;
  }

  #draw(item) {
    this.#view.unobserve(item);
    const pattern = this.#byName.get(item.dataset.name);
    // Where the pins of another array stand is not known here.
    if (isForeign(pattern)) return;
    this.details(pattern).then((details) => pattern.sha256 === this.#byName.get(pattern.name)?.sha256 && item.querySelector(".map").replaceChildren(thumbnail(details.highest_um)), () => {});
  }

  // Marks the chosen pattern.
  #mark() {
    for (const item of $("pattern-list").children) this.#markItem(item);
  }

  #markItem(item) {
    const chosen = this.#chosen.name === item.dataset.name;
    item.classList.toggle("chosen", chosen);
    item.querySelector(".choose")?.setAttribute("aria-pressed", chosen);
  }

  // Throws if the pattern cannot be played as the fields say; a wrong field says so itself.
  #ready(pattern) {
    if (!right("seconds", "scale")) return false;
    checkArray(pattern);
    if (pattern.duration_s === null && optional("seconds") === undefined) throw new Error(`“${pattern.name}” has no end: enter its seconds.`);
    return true;
  }

  async #play(pattern) {
    const body = { pattern: pattern.name, pattern_sha256: pattern.sha256, seconds: optional("seconds"), scale: number("scale") };
    try {
      await this.#check(pattern);
    } catch (error) {
      // Its button is gone.
      if (!this.#byName.has(pattern.name)) return void refuse($("patterns-title"), error);
      throw error;
    }
    await order("/v1/play", body);
  }
}
