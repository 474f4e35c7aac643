// What the pins did last, again and slowly: a slider, and a button that lets it run.

import { $, write } from "./control.js";

// How much slower it is shown.
const SLOWER = 20;

export class Replay {
  #stage;
  #take = null;
  // What is shown: ms from the first movement on; null: the present.
  #ms = null;
  #from = 0;
  #running = 0;

  constructor(stage) {
    this.#stage = stage;
    $("slowly").addEventListener("click", () => (this.#running ? this.now() : this.#run()));
    $("at").addEventListener("input", () => (this.#stop(), this.#show(Number($("at").value))));
    $("now").addEventListener("click", () => this.now());
  }

  // Takes what the pins did, from the first movement to the last.
  set(take) {
    this.now();
    this.#take = take;
    const [from, to] = take.moved();
    this.#from = from;
    $("at").max = to - from;
    $("replay").hidden = false;
  }

  // The finger shows the present.
  now() {
    this.#stop();
    this.#ms = null;
    $("at").value = 0;
    $("now").disabled = true;
    this.#stage.show(null);
  }

  #show(ms) {
    this.#ms = Math.min(ms, Number($("at").max));
    $("at").value = this.#ms;
    $("now").disabled = false;
    this.#stage.show({ take: this.#take, ms: this.#from + this.#ms, text: `What the pins did, ${this.#ms.toFixed(0)} of ${$("at").max} ms.` });
  }

  #run() {
    write($("slowly"), "Stop showing");
    if (this.#ms === null || this.#ms >= Number($("at").max)) this.#show(0);
    let before = performance.now();
    const turn = () => {
      const now = performance.now();
      this.#show(this.#ms + (now - before) / SLOWER);
      before = now;
      if (this.#ms < Number($("at").max)) this.#running = requestAnimationFrame(turn);
      else this.#stop();
    };
    this.#running = requestAnimationFrame(turn);
  }

  #stop() {
    cancelAnimationFrame(this.#running);
    this.#running = 0;
    write($("slowly"), "Again, slowly");
  }
}
