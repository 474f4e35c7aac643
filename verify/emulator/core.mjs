// The Cortex-M0+ of core 0: its loop, exception entry and return, sleep, faults. rp2040js takes exceptions despite PRIMASK,
// loses wake-ups and has no faults. Elsewhere: the instructions (interpreter.mjs), which exception is next (exceptions.mjs),
// the bus (bus.mjs). Flash waits, the second core and bus contention are not modelled.
// Invariant: `t[NOW]` is the cycle at which the current instruction began; peripherals see that time.

import { Fault } from './bus.mjs';
import { NEXT, NOW } from './clock.mjs';
import { Exceptions, HARDFAULT } from './exceptions.mjs';
import { Interpreter, WFE, WFI } from './interpreter.mjs';

const AWAKE = 0;
/** Asleep until a reset: lockup, or the bench has stopped the core. */
const DEAD = 3;

// TRM: exception entry takes 15 cycles with zero-wait memory; the return takes about as long, without fetching a vector.
const ENTRY_CYCLES = 15;
const RETURN_CYCLES = 10;

export class Core extends Interpreter {
  /** `slow` multiplies the cost of every instruction, not the time of the peripherals. */
  constructor(clock, bus, slow = 1) {
    super(bus);
    this.clock = clock;
    this.slow = slow;
    this.vtor = 0;
    this.asleep = AWAKE;
    this.stopped = false;
    this.exceptions = new Exceptions(this);
    this.counts = new Float64Array(2); // instructions, cycles asleep
    this.carryOver = 0; // fractions of a cycle, with a fractional `slow`
    // rp2040js's own peripherals use these two of its core
    this.cycles = 0;
    this.interruptNMIMask = 0;
  }

  setInterrupt(irq, high) {
    this.exceptions.setLine(irq, high);
  }
  get dead() {
    return this.asleep === DEAD;
  }
  die() {
    this.asleep = DEAD;
    this.attention = true;
  }
  jump(address) {
    if (this.asleep !== DEAD) this.asleep = AWAKE;
    this.r[15] = address & ~1;
  }
  /** Makes `run` return. */
  stop() {
    this.stopped = true;
    this.attention = true;
  }

  // ---- the loop

  run(limit) {
    const { t } = this.clock;
    this.stopped = false;
    while (t[NOW] < limit && !this.stopped) {
      if (t[NOW] >= t[NEXT]) this.clock.runDue();
      try {
        if (this.attention) t[NOW] += this.attend();
        if (this.stopped) break;
        if (this.asleep === AWAKE) this.burst(limit);
        else this.doze(Math.min(limit, t[NEXT]));
      } catch (e) {
        if (!(e instanceof Fault)) throw e;
        this.hardFault();
      }
    }
  }
  doze(until) {
    const { t } = this.clock;
    if (until <= t[NOW]) return;
    this.counts[1] += until - t[NOW];
    t[NOW] = until;
  }
  burst(limit) {
    const { t } = this.clock;
    let executed = 0;
    try {
      if (this.slow === 1) {
        do {
          executed++;
          t[NOW] += this.step();
        } while (t[NOW] < limit && t[NOW] < t[NEXT] && !this.attention);
      } else executed = this.slowBurst(limit);
    } finally {
      this.counts[0] += executed;
    }
  }
  slowBurst(limit) {
    const { t } = this.clock;
    let executed = 0;
    do {
      executed++;
      const cost = this.step() * this.slow + this.carryOver;
      const whole = Math.floor(cost);
      this.carryOver = cost - whole;
      t[NOW] += whole;
    } while (t[NOW] < limit && t[NOW] < t[NEXT] && !this.attention);
    return executed;
  }

  /** Takes the next exception, or wakes, or continues. Returns the cycles spent. */
  attend() {
    this.attention = false;
    if (this.asleep === DEAD) return 0;
    const ex = this.exceptions;
    const number = ex.next(this.primask ? Math.min(ex.current, 0) : ex.current);
    if (number) {
      this.asleep = AWAKE;
      this.enter(number, this.r[15]);
      return ENTRY_CYCLES;
    }
    // PRIMASK keeps an exception from being taken, not from ending WFI
    if (this.asleep === WFI && ex.next(ex.current)) this.asleep = AWAKE;
    if (this.asleep === WFE && this.event) {
      this.event = false;
      this.asleep = AWAKE;
    }
    return 0;
  }

  // ---- exceptions

  enter(number, returnAddress) {
    const { r, bus } = this;
    const thread = this.ipsr === 0;
    const padded = (r[13] >> 2) & 1;
    const frame = (r[13] - 0x20) & ~7;
    let handler = 0;
    try {
      for (let i = 0; i < 4; i++) bus.write32(frame + 4 * i, r[i]);
      bus.write32(frame + 16, r[12]);
      bus.write32(frame + 20, r[14]);
      bus.write32(frame + 24, returnAddress);
      bus.write32(frame + 28, this.psr | (padded << 9));
      handler = bus.read32(this.vtor + 4 * number) & ~1;
    } catch (e) {
      if (!(e instanceof Fault)) throw e;
      // without a stack or a vector for the fault the chip locks up
      return this.die();
    }
    r[13] = frame;
    r[14] = thread ? 0xfffffff9 : 0xfffffff1;
    this.exceptions.enter(number);
    this.ipsr = number;
    this.event = true;
    r[15] = handler;
    this.attention = true;
  }
  leave() {
    const { r, bus } = this;
    const number = this.ipsr;
    const frame = r[13];
    for (let i = 0; i < 4; i++) r[i] = bus.read32(frame + 4 * i);
    r[12] = bus.read32(frame + 16);
    r[14] = bus.read32(frame + 20);
    r[15] = bus.read32(frame + 24) & ~1;
    const psr = bus.read32(frame + 28);
    r[13] = (frame + 0x20) | (psr & (1 << 9) ? 4 : 0);
    this.flags = psr;
    this.ipsr = psr & 0x3f;
    this.event = true;
    this.exceptions.leave(number);
  }
  /** Raises a fault; the stacked address is that of the instruction or, after a bad access, of the next one. */
  hardFault() {
    if (this.asleep === DEAD) return;
    if (this.exceptions.current <= -1) return this.die();
    this.asleep = AWAKE;
    this.enter(HARDFAULT, this.r[15]);
    this.clock.t[NOW] += ENTRY_CYCLES;
  }
  sleep(how) {
    this.asleep = how;
    this.attention = true; // a pending exception ends it at once
  }
  /** BX, POP and MOV to PC: jumps to an address, or returns from an exception. */
  branch(address) {
    if (this.ipsr !== 0 && address >>> 28 === 0xf) {
      this.leave();
      return RETURN_CYCLES;
    }
    if (!(address & 1)) throw new Fault('branch without the Thumb bit');
    this.r[15] = address & ~1;
    return 0;
  }
}
