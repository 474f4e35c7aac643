// What the pins do now, whatever moves them: a play, a live play, a return. While something moves the daemon is asked ten times a second
// for what each pin did in every millisecond since; else the status tells where the pins are.
//
// Invariant: heights are those of an answer that is less than a second old, and known only as long as the state is.

import { call, known } from "./api.js";
import { highest, isMoving } from "./pins.js";
import { Take } from "./take.js";

const ASK_MS = 100;
const FRESH_MS = 900;
// The daemon looks at its pins ten times a second, and an answer takes its time: so much behind it the page draws what it was told.
const BEHIND_MS = 250;
// Cuts are known a little later: the last piece is fetched again, ms.
const AGAIN_MS = 150;
// A frame shows the highest point since the frame before, at least of so many ms.
const FRAME_MS = 17;
// After the last movement the pins stay in sight of the feed for so long.
const LINGER_MS = 600;

export class Feed {
  #take = null;
  // When the newest answer came, and the time of the take less that of the window, ms.
  #came = -Infinity;
  #ahead = -Infinity;
  #since = 0;
  #timer = 0;
  #until = 0;
  #ended;

  // `ended(take)`: called when the pins rest again.
  constructor(ended) {
    this.#ended = ended;
    document.addEventListener("state", () => this.#watch());
    document.addEventListener("visibilitychange", () => this.#watch());
  }

  get isRunning() {
    return this.#timer !== 0;
  }

  #watch() {
    const status = known();
    const moves = status && (status.play || status.state === "returning" || status.motors.some(({ now }) => now && isMoving(now)));
    if (moves) this.#until = performance.now() + LINGER_MS;
    if (moves && !document.hidden && !this.isRunning) this.#ask();
  }

  async #ask() {
    this.#timer = -1;
    const since = this.#take ? `?since_tick=${this.#since}` : "";
    const answer = await call("GET", `/v1/heights${since}`).catch(() => null);
    if (answer?.heights_um.length) this.#add(answer);
    if (!document.hidden && performance.now() < this.#until) this.#timer = setTimeout(() => this.#ask(), ASK_MS);
    else this.#end();
  }

  #add(answer) {
    const before = (ms) => Math.max(0, answer.tick - Math.round((ms / 1000) * answer.tick_hz));
    this.#since = before(AGAIN_MS);
    const begin = () => {
      this.#ahead = -Infinity;
      return new Take(answer.heights_um.length, before(BEHIND_MS), answer.tick_hz);
    };
    this.#take ??= begin();
    if (!this.#take.add(answer)) (this.#take = begin()).add(answer);
    this.#came = performance.now();
    // An answer that was slow is no jump of the clock.
    this.#ahead = Math.max(this.#ahead - 1, this.#take.ms - this.#came);
  }

  #end() {
    const take = this.#take;
    [this.#timer, this.#take, this.#came] = [0, null, -Infinity];
    if (take?.moved()) this.#ended(take);
  }

  // The time that is drawn now, ms of the take; null without one.
  #time() {
    if (!this.#take || performance.now() - this.#came > FRESH_MS) return null;
    return Math.min(performance.now() + this.#ahead - BEHIND_MS, this.#take.ms);
  }

  // The height of each pin now, µm, and null for one of which it is not known; null if nothing is known.
  now() {
    const status = known();
    if (!status) return null;
    const time = this.#time();
    return status.motors.map(({ now }, motor) => {
      if (!now) return null;
      // While nothing is fresh, the status tells what it knows.
      return time > 0 ? this.#take.at(motor, Math.floor(time) - FRAME_MS, Math.floor(time))[1] : highest(now);
    });
  }
}
