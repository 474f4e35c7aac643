// Exceptions of the ARMv6-M core: pending, enabled, active, priorities. It decides which exception comes next. The core takes
// it (stack frame, vector); the registers are in ppb.mjs.
// Lines are level-sensitive as on the M0+'s NVIC: a rise is latched, and a line still high when its handler returns pends again.

export const HARDFAULT = 3;
export const SVCALL = 11;
export const SYSTICK = 15;
/** Priority of thread mode: lower than any exception's. */
const THREAD = 4;

export class Exceptions {
  constructor(core) {
    this.core = core;
    this.lines = 0; // interrupt lines as the peripherals drive them
    this.pending = 0;
    this.enabled = 0;
    this.system = 0; // pending exceptions 2..15, by number
    this.active = []; // innermost last
    this.current = THREAD; // priority of the running code, without PRIMASK
    this.priority = new Int8Array(48);
    this.priority[HARDFAULT] = -1;
  }
  /** Level of a peripheral's interrupt line. */
  setLine(irq, high) {
    const bit = 1 << irq;
    if (!high) this.lines &= ~bit;
    else if (!(this.lines & bit)) {
      this.lines |= bit;
      this.pend(bit);
    }
  }
  pend(mask) {
    this.pending |= mask;
    this.core.attention = true;
  }
  unpend(mask) {
    this.pending &= ~mask;
    for (let i = 0; i < 32; i++) if (mask & this.lines & (1 << i) && !this.active.includes(16 + i)) this.pending |= 1 << i;
  }
  pendSystem(number) {
    this.system |= 1 << number;
    this.core.attention = true;
  }
  /** The exception that would preempt `limit`, 0 for none. The lowest number wins among equals. */
  next(limit) {
    let best = 0;
    let urgency = limit;
    for (let m = this.system; m; m &= m - 1) {
      const n = 31 - Math.clz32(m & -m);
      if (this.priority[n] < urgency) [best, urgency] = [n, this.priority[n]];
    }
    for (let m = this.pending & this.enabled; m; m &= m - 1) {
      const n = 16 + 31 - Math.clz32(m & -m);
      if (this.priority[n] < urgency) [best, urgency] = [n, this.priority[n]];
    }
    return best;
  }
  enter(number) {
    if (number >= 16) this.pending &= ~(1 << (number - 16));
    else this.system &= ~(1 << number);
    this.active.push(number);
    this.current = Math.min(this.current, this.priority[number]);
  }
  leave(number) {
    this.active.splice(this.active.lastIndexOf(number), 1);
    this.current = THREAD;
    for (const n of this.active) this.current = Math.min(this.current, this.priority[n]);
    if (number >= 16 && this.lines & (1 << (number - 16))) this.pend(1 << (number - 16));
    this.core.attention = true;
  }
}
