// The small system peripherals that rp2040js lacks or gets wrong: tick, timer, watchdog, reset controller, crystal,
// ring oscillator (random bits), voltage regulator. board.mjs carries out a watchdog's reset.
// Times are whole ticks of the crystal's 12 MHz divided by WATCHDOG_TICK, so an alarm never fires before its microsecond.

import { BasePeripheral } from 'rp2040js';

const CRYSTAL_HZ = 12e6;

/** The 1 µs tick of watchdog and timer; it stands still until the firmware starts it. */
export class Tick {
  constructor(clock) {
    this.clock = clock;
    this.control = 0;
    this.nanosPerTick = Infinity;
    this.base = 0;
    this.baseNanos = clock.nanos;
    this.listeners = [];
  }
  get count() {
    if (this.nanosPerTick === Infinity) return this.base;
    return this.base + Math.floor((this.clock.nanos - this.baseNanos) / this.nanosPerTick + 1e-6);
  }
  nanosUntil(count) {
    return this.baseNanos + (count - this.base) * this.nanosPerTick - this.clock.nanos;
  }
  set(control) {
    this.base = this.count;
    this.baseNanos = this.clock.nanos;
    this.control = control & 0x3ff;
    const cycles = control & 0x1ff;
    this.nanosPerTick = control & 0x200 && cycles ? (cycles * 1e9) / CRYSTAL_HZ : Infinity;
    for (const f of this.listeners) f();
  }
}

export class Timer extends BasePeripheral {
  constructor(rp2040, tick) {
    super(rp2040, 'TIMER');
    this.tick = tick;
    this.raw = this.enable = 0;
    this.alarms = [0, 1, 2, 3].map((i) => ({ target: 0, armed: false, alarm: rp2040.clock.createAlarm(() => this.fire(i)) }));
    tick.listeners.push(() => this.alarms.forEach((_, i) => this.schedule(i)));
  }
  get time() {
    return this.tick.count;
  }
  schedule(i) {
    const a = this.alarms[i];
    a.alarm.cancel();
    if (!a.armed || this.tick.nanosPerTick === Infinity) return;
    const now = this.time;
    const ahead = (a.target - (now % 2 ** 32)) >>> 0; // a time that has just passed comes again in 72 minutes
    a.alarm.schedule(Math.max(0, this.tick.nanosUntil(now + ahead)));
  }
  fire(i) {
    this.alarms[i].armed = false;
    this.raw |= 1 << i;
    this.update();
  }
  update() {
    const status = this.raw & this.enable;
    for (let i = 0; i < 4; i++) this.rp2040.setInterrupt(i, (status & (1 << i)) !== 0);
  }
  readUint32(offset) {
    switch (offset) {
      case 0x24:
        return Math.floor(this.time / 2 ** 32);
      case 0x28:
        return this.time % 2 ** 32;
      case 0x38:
        return this.enable;
      default:
        throw new Error(`the timer's register ${offset.toString(16)} is not modelled`);
    }
  }
  writeUint32(offset, v) {
    if (offset >= 0x10 && offset < 0x20) {
      const i = (offset - 0x10) >> 2;
      Object.assign(this.alarms[i], { target: v, armed: true });
      this.schedule(i);
    } else if (offset === 0x20) {
      this.alarms.forEach((a, i) => {
        if (!(this.rawWriteValue & (1 << i))) return;
        a.armed = false;
        a.alarm.cancel();
      });
    } else if (offset === 0x34) this.raw &= ~this.rawWriteValue;
    else if (offset === 0x38) this.enable = v & 15;
    else throw new Error(`the timer's register ${offset.toString(16)} is not modelled`);
    this.update();
  }
}

/** SCRATCH and REASON survive a watchdog reset, so the board passes them in. */
export class Watchdog extends BasePeripheral {
  constructor(rp2040, tick, kept, onReset) {
    super(rp2040, 'WATCHDOG');
    Object.assign(this, { tick, kept, onReset });
    this.pause = 7 << 24;
    this.enabled = false;
    this.remaining = 0; // in half microseconds: erratum RP2040-E1 counts down twice a tick
    this.since = 0;
    this.alarm = rp2040.clock.createAlarm(() => this.bite(1));
    tick.listeners.push(() => this.hold());
  }
  get left() {
    return this.enabled ? Math.max(0, this.remaining - 2 * (this.tick.count - this.since)) : this.remaining;
  }
  hold(left = this.left) {
    this.remaining = left;
    this.since = this.tick.count;
    this.alarm.cancel();
    if (this.enabled && this.tick.nanosPerTick !== Infinity)
      this.alarm.schedule(this.tick.nanosUntil(this.since + Math.ceil(left / 2)));
  }
  bite(reason) {
    this.kept.reason = reason;
    this.onReset();
  }
  readUint32(offset) {
    if (offset === 0) return (this.enabled ? 1 << 30 : 0) | this.pause | this.left;
    if (offset === 8) return this.kept.reason;
    if (offset >= 0x0c && offset < 0x2c) return this.kept.scratch[(offset - 0x0c) >> 2];
    if (offset === 0x2c) return this.tick.control | (this.tick.control & 0x200 ? 0x400 : 0);
    return 0;
  }
  writeUint32(offset, v) {
    if (offset === 0) {
      const { left } = this;
      this.pause = v & (7 << 24);
      this.enabled = !!(v & (1 << 30));
      this.hold(left);
      if (v >>> 31) this.bite(2);
    } else if (offset === 4) this.hold(v & 0xffffff);
    else if (offset >= 0x0c && offset < 0x2c) this.kept.scratch[(offset - 0x0c) >> 2] = v;
    else if (offset === 0x2c) this.tick.set(v);
  }
}

/** RESETS: a peripheral in reset loses its state, if it has a reset function (`blocks`: bit → function). */
export class Resets extends BasePeripheral {
  constructor(rp2040, blocks) {
    super(rp2040, 'RESETS');
    this.blocks = blocks;
    this.held = 0x1ffffff;
    this.wdsel = 0;
  }
  readUint32(offset) {
    return offset === 0 ? this.held : offset === 4 ? this.wdsel : offset === 8 ? 0x1ffffff & ~this.held : 0;
  }
  writeUint32(offset, v) {
    if (offset === 4) this.wdsel = v;
    if (offset !== 0) return;
    const asserted = v & ~this.held;
    this.held = v & 0x1ffffff;
    for (const [bit, reset] of this.blocks) if (asserted & (1 << bit)) reset();
  }
}

/** The crystal oscillator: stable when STARTUP's count of 256 of its cycles is over. DORMANT is not modelled. */
export class Crystal extends BasePeripheral {
  constructor(rp2040) {
    super(rp2040, 'XOSC');
    this.clock = rp2040.clock;
    this.words = new Map();
    this.stableAt = Infinity;
  }
  readUint32(offset) {
    if (offset !== 4) return this.words.get(offset) ?? 0;
    return (this.stableAt < Infinity ? 0x1000 : 0) | (this.clock.nanos >= this.stableAt ? 1 << 31 : 0);
  }
  writeUint32(offset, v) {
    this.words.set(offset, v);
    if (offset !== 0) return;
    const startup = this.words.get(0x0c) ?? 0xc4;
    const counts = (startup & 0x3fff) * 256 * (startup & (1 << 20) ? 4 : 1);
    this.stableAt = ((v >>> 12) & 0xfff) === 0xfab ? this.clock.nanos + (counts * 1e9) / CRYSTAL_HZ : Infinity;
  }
}

/** Only RANDOMBIT has a behaviour. The sequence belongs to the board and continues over chip resets. */
export class RingOscillator extends BasePeripheral {
  constructor(rp2040, random) {
    super(rp2040, 'ROSC');
    this.random = random;
    this.words = new Map([[0, 0xfabfa0]]);
  }
  readUint32(offset) {
    if (offset === 0x1c) return this.random() & 1;
    if (offset === 0x18) return 0x80001000; // stable, enabled
    return this.words.get(offset) ?? 0;
  }
  writeUint32(offset, v) {
    this.words.set(offset, v);
  }
}

/** SYSINFO: CHIP_ID, with revision 1 for B0 and B1, 2 for B2. */
export class ChipId extends BasePeripheral {
  constructor(rp2040, revision) {
    super(rp2040, 'SYSINFO');
    this.revision = revision;
  }
  readUint32(offset) {
    return offset === 0 ? ((this.revision << 28) | 0x0002927) >>> 0 : offset === 4 ? 2 : 0;
  }
}

/** Regulation is always good; CHIP_RESET has the flags that the board keeps. */
export class Regulator extends BasePeripheral {
  constructor(rp2040, { chipReset }) {
    super(rp2040, 'VREG_AND_CHIP_RESET');
    this.words = new Map([[0, 0xb1], [4, 0x91], [8, chipReset]]);
  }
  readUint32(offset) {
    return (this.words.get(offset) ?? 0) | (offset === 0 ? 0x1000 : 0);
  }
  writeUint32(offset, v) {
    this.words.set(offset, v);
  }
}

/** Registers that only store: for blocks that the firmware sets up and that have no effect here. */
export class Memory extends BasePeripheral {
  constructor(rp2040, name) {
    super(rp2040, name);
    this.words = new Map();
  }
  readUint32(offset) {
    return this.words.get(offset) ?? 0;
  }
  writeUint32(offset, v) {
    this.words.set(offset, v);
  }
}

/** xorshift32: a seed gives the same boot ids on every machine. */
export function randomBits(seed) {
  let x = (seed * 0x9e3779b1 + 0x6d2b79f5) >>> 0 || 1;
  return () => {
    x ^= x << 13;
    x ^= x >>> 17;
    x ^= x << 5;
    return x >>> 16;
  };
}
