// The core's private peripherals: SysTick, NVIC registers, System Control Block.
// SysTick counts exact clk_sys cycles from an anchor instead of being stepped; with CLKSOURCE = 0 it counts the 1 µs tick.
// Other registers are errors.

import { SYSTICK } from './exceptions.mjs';

const MAX = 0xffffff;

export class SysTick {
  constructor(clock, pend) {
    this.clock = clock;
    this.pend = pend;
    this.control = 0;
    this.reload = 0;
    this.countFlag = false;
    this.anchor = clock.cycle; // cycle at which the counter was `from`
    this.from = 0;
    this.alarm = clock.createAlarm(() => this.zero());
  }
  get cyclesPerCount() {
    return this.control & 4 ? 1 : this.clock.hz / 1e6;
  }
  get value() {
    if (!(this.control & 1)) return this.from;
    const gone = Math.floor((this.clock.cycle - this.anchor) / this.cyclesPerCount);
    if (gone <= this.from) return this.from - gone;
    return this.reload - ((gone - this.from - 1) % (this.reload + 1));
  }
  /** Sets a new anchor at the present value, before a setting changes. */
  hold(value = this.value) {
    this.from = value;
    this.anchor = this.clock.cycle;
  }
  arm() {
    this.alarm.cancel();
    if (!(this.control & 1)) return;
    const v = this.value;
    const counts = v > 0 ? v : this.reload + 1;
    if (v === 0 && this.reload === 0) return; // a zero reload stops the counter
    const already = Math.floor((this.clock.cycle - this.anchor) / this.cyclesPerCount);
    this.alarm.scheduleAt(this.anchor + Math.ceil((already + counts) * this.cyclesPerCount));
  }
  zero() {
    this.countFlag = true;
    if (this.control & 2) this.pend();
    this.arm();
  }
  read(register) {
    if (register === 0x14) return this.reload;
    if (register === 0x18) return this.value;
    if (register === 0x1c) return 0xc0000000; // CALIB: no reference, no skew known
    const v = this.control | (this.countFlag ? 1 << 16 : 0);
    this.countFlag = false;
    return v;
  }
  write(register, v) {
    if (register === 0x10) {
      this.hold();
      this.control = v & 7;
    } else if (register === 0x14) {
      this.hold();
      this.reload = v & MAX;
    } else if (register === 0x18) {
      this.hold(0); // any write clears it, without pending
      this.countFlag = false;
    }
    this.arm();
  }
}

export class PrivatePeripherals {
  constructor(core, clock) {
    this.core = core;
    this.exceptions = core.exceptions;
    this.systickTimer = {}; // rp2040js writes a frequency here when clk_sys changes; ours counts cycles
    this.systick = new SysTick(clock, () => this.exceptions.pendSystem(SYSTICK));
    this.scr = 0;
  }
  readUint32(offset) {
    const ex = this.exceptions;
    if (offset >= 0x10 && offset <= 0x1c) return this.systick.read(offset);
    if (offset >= 0x400 && offset < 0x420) {
      let v = 0;
      for (let i = 0; i < 4; i++) v |= ex.priority[16 + offset - 0x400 + i] << (8 * i + 6);
      return v;
    }
    switch (offset) {
      case 0xd04: {
        const external = ex.pending & ex.enabled;
        return (ex.system & (1 << SYSTICK) ? 1 << 26 : 0) | (external ? 1 << 22 : 0) | (ex.next(5) << 12) | this.core.ipsr;
      }
      case 0xd08:
        return this.core.vtor;
      default:
        throw new Error(`the register ${offset.toString(16)} of the core's peripherals is not modelled`);
    }
  }
  writeUint32(offset, v) {
    const ex = this.exceptions;
    if (offset >= 0x10 && offset <= 0x1c) return this.systick.write(offset, v);
    if (offset >= 0x400 && offset < 0x420) {
      for (let i = 0; i < 4; i++) ex.priority[16 + offset - 0x400 + i] = (v >>> (8 * i + 6)) & 3;
      this.core.attention = true;
      return;
    }
    switch (offset) {
      case 0x100:
        ex.enabled |= v;
        this.core.attention = true;
        break;
      case 0x180:
        ex.enabled &= ~v;
        break;
      case 0x200:
        ex.pend(v);
        break;
      case 0x280:
        ex.unpend(v);
        break;
      case 0xd08:
        this.core.vtor = v & 0xffffff00;
        break;
      default:
        throw new Error(`the register ${offset.toString(16)} of the core's peripherals is not modelled`);
    }
  }
}
