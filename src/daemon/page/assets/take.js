// What all pins did, every millisecond, as the daemon says it: `at(motor, from, to)` is the lowest and the highest height in that time, µm.

// What is kept of what the pins did, ms.
const MOST_MS = 60000;
function range(value, from, to) {
  let [low, high] = [Infinity, 0];
  for (let ms = from; ms < to; ms += 1) {
    const um = value(ms);
    if (um < low) low = um;
    if (um > high) high = um;
  }
  return [Math.min(low, high), high];
}

export class Take {
  // How long it is.
  ms = 0;
  #data;
  // The device's time of the first height, ticks, and ticks per ms.
  #first;
  #per_ms;

  constructor(motors, tick, tick_hz) {
    [this.motors, this.#first, this.#per_ms] = [motors, tick, tick_hz / 1000];
    this.#data = new Float32Array(motors * 2048);
  }

  // The time of a tick in this take, ms.
  timeOf(tick) {
    return (tick - this.#first) / this.#per_ms;
  }

  // Adds what `GET /v1/heights` says. Returns false if it does not go on from here.
  add({ tick, step_ms, heights_um: heights }) {
    const last = Math.round(this.timeOf(tick));
    const count = heights.reduce((most, values) => Math.max(most, values.length), 1);
    if (step_ms !== 1 || heights.length !== this.motors || last < this.ms - 1 || last > MOST_MS) return false;
    while (this.#data.length < (last + 1) * this.motors) {
      const larger = new Float32Array(2 * this.#data.length);
      larger.set(this.#data);
      this.#data = larger;
    }
    // What came before may have been cut since: the newest word counts. What is missing is as the first word after it.
    const from = Math.max(0, Math.min(this.ms, last + 1 - count));
    heights.forEach((values, motor) => {
      for (let ms = from; ms <= last; ms += 1) this.#data[ms * this.motors + motor] = values[values.length - 1 - (last - ms)] ?? values[0];
    });
    this.ms = last + 1;
    return true;
  }

  at(motor, from, to) {
    return range((ms) => this.#data[ms * this.motors + motor], Math.max(0, from), Math.min(to, this.ms));
  }

  // From the first to the last movement, ms; null if nothing moved.
  moved() {
    const isUp = (ms) => this.#data.subarray(ms * this.motors, (ms + 1) * this.motors).some((um) => um > 0);
    let [from, to] = [0, this.ms];
    while (from < to && !isUp(from)) from += 1;
    while (to > from && !isUp(to - 1)) to -= 1;
    return to > from ? [from, to] : null;
  }
}
