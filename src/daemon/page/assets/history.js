// What can be undone: a list of states that do not change. The newest one survives a reload of the page, in the browser's storage.

const KEY = "meissner-design";
const MOST = 200;

export class History {
  #states = [];
  #at = -1;

  get now() {
    return this.#states[this.#at];
  }

  get canUndo() {
    return this.#at > 0;
  }

  get canRedo() {
    return this.#at + 1 < this.#states.length;
  }

  // Adds a state. Returns whether it is another one than the newest.
  add(state) {
    if (JSON.stringify(state) === JSON.stringify(this.now)) return false;
    this.#states = [...this.#states.slice(0, this.#at + 1), state].slice(-MOST);
    this.#at = this.#states.length - 1;
    return true;
  }

  // The state before or after; undefined if there is none.
  move(by) {
    if (!this.#states[this.#at + by]) return undefined;
    this.#at += by;
    return this.now;
  }
}

// Returns whether the browser has kept it.
export function keep(state) {
  try {
    localStorage.setItem(KEY, JSON.stringify(state));
    return true;
  } catch {
    // No storage, or a file that is too large for it.
    return false;
  }
}

// The state that was kept; null if there is none.
export function kept() {
  try {
    return JSON.parse(localStorage.getItem(KEY));
  } catch {
    return null;
  }
}
