// The DMA controller: paced by the PIO's FIFOs or unpaced, rings, chains, interrupts.
// rp2040js sets an alarm per transfer; here a paced channel moves at once all words that the FIFO requests, and an unpaced one
// moves a word per cycle, in steps of `STEP` words. Not modelled: pacing timers, sniffer, byte swap, the few cycles between a request
// and its transfer, contention for the bus, and priorities between channels.

import { BasePeripheral } from 'rp2040js';
import { Fault } from './bus.mjs';

const CHANNELS = 12;
const UNPACED = 0x3f;
const STEP = 8;
const EN = 1;
const BUSY = 1 << 24;
const BUS_ERROR = (1 << 31) | (1 << 30);
const QUIET = 1 << 21;
const IRQ0 = 11;
// the register of each of a channel's 16 words: 0 read, 1 write, 2 count, 3 control; the last of each four triggers
const ALIASES = [0, 1, 2, 3, 3, 0, 1, 2, 3, 2, 0, 1, 3, 1, 2, 0];

class Channel {
  constructor(dma, index) {
    this.dma = dma;
    this.index = index;
    this.read = 0;
    this.write = 0;
    this.count = 0;
    this.reload = 0;
    this.moving = false;
    this.alarm = dma.rp2040.clock.createAlarm(() => this.stride());
    this.control = index << 11; // a channel chained to itself is not chained
    this.unpack();
  }
  unpack() {
    const c = this.control;
    this.size = (c >> 2) & 3;
    this.treq = (c >> 15) & 63;
    this.chain = (c >> 11) & 15;
    const ring = (1 << ((c >> 6) & 15)) - 1;
    // bits of the address that change: all, or those of the ring
    this.readMask = c & (1 << 10) || !ring ? -1 : ring;
    this.writeMask = c & (1 << 10) && ring ? ring : -1;
    this.readStep = c & (1 << 4) ? 1 << this.size : 0;
    this.writeStep = c & (1 << 5) ? 1 << this.size : 0;
  }
  get busy() {
    return (this.control & BUSY) !== 0;
  }
  trigger() {
    if (!(this.control & EN) || this.busy) return;
    this.count = this.reload;
    if (this.count === 0) return this.finish();
    this.control |= BUSY;
    this.go();
  }
  go() {
    if (!(this.control & EN) || !this.busy) return;
    if (this.treq === UNPACED) this.alarm.scheduleAt(this.dma.rp2040.clock.cycle + Math.min(STEP, this.count));
    else this.paced();
  }
  stride() {
    try {
      for (let n = Math.min(STEP, this.count); n > 0; n--) this.moveNext();
    } catch (e) {
      this.busError(e);
    }
    if (this.count === 0) this.finish();
    else this.go();
  }
  /** Moves words while the requesting FIFO has room, or holds data. */
  paced() {
    // a FIFO that still has room requests again
    if (this.moving || this.treq > 15) return;
    const machine = this.dma.rp2040.pio[this.treq >> 3].machines[this.treq & 3];
    this.moving = true;
    try {
      if (this.treq & 4) while (this.count > 0 && machine.rxFIFO.used > 0) this.moveNext();
      else if (this.write === machine.txAddress && this.size === 2) this.feed(machine);
      else while (this.count > 0 && !machine.txFIFO.full) this.moveNext();
    } catch (e) {
      this.busError(e);
    }
    this.moving = false;
    if (this.count === 0) this.finish();
  }
  /** The firmware's case, without the detour through the bus. */
  feed(machine) {
    const { bus } = this.dma.rp2040;
    const fifo = machine.txFIFO;
    while (this.count > 0 && fifo.used < fifo.buffer.length) {
      this.count--;
      machine.writeFIFO(bus.read32(this.read));
      this.read = (this.read & ~this.readMask) | ((this.read + this.readStep) & this.readMask);
    }
  }
  /** The channel halts, as on the chip. */
  busError(e) {
    if (!(e instanceof Fault)) throw e;
    this.control |= BUS_ERROR;
    this.count = 0;
  }
  moveNext() {
    this.count--;
    const { bus } = this.dma.rp2040;
    if (this.size === 2) bus.write32(this.write, bus.read32(this.read));
    else if (this.size === 1) bus.write16(this.write, bus.read16(this.read));
    else bus.write8(this.write, bus.read8(this.read));
    this.read = (this.read & ~this.readMask) | ((this.read + this.readStep) & this.readMask);
    this.write = (this.write & ~this.writeMask) | ((this.write + this.writeStep) & this.writeMask);
  }
  finish() {
    this.control &= ~BUSY;
    if (this.chain !== this.index) this.dma.channels[this.chain]?.trigger();
  }
  abort() {
    this.alarm.cancel();
    this.control &= ~BUSY;
    this.count = 0;
  }
  readRegister(word) {
    return [this.read, this.write, this.count, this.control][ALIASES[word]] >>> 0;
  }
  writeRegister(word, v) {
    const which = ALIASES[word];
    if (which === 0) this.read = v | 0;
    else if (which === 1) this.write = v | 0;
    else if (which === 2) this.reload = v;
    else {
      this.control = (this.control & ~0xffffff) | (v & 0xffffff);
      this.unpack();
      if (!(v & EN)) this.alarm.cancel();
      else this.go();
    }
    if ((word & 3) !== 3) return;
    // the null trigger: writing zero starts nothing
    if (v !== 0) this.trigger();
  }
}

export class Dma extends BasePeripheral {
  constructor(rp2040, name) {
    super(rp2040, name);
    this.channels = [];
    this.reset();
  }
  reset() {
    for (const c of this.channels) c.alarm.cancel();
    this.channels = Array.from({ length: CHANNELS }, (_, i) => new Channel(this, i));
  }
  /** A FIFO has room, or data. */
  requested(treq) {
    for (let i = 0; i < CHANNELS; i++) {
      const c = this.channels[i];
      if (c.treq === treq && c.busy && c.control & EN) c.paced();
    }
  }
  // the requests of rp2040js's other peripherals; none of them is served
  setDREQ() {}
  clearDREQ() {}
  readUint32(offset) {
    if (offset < CHANNELS * 64) return this.channels[offset >> 6].readRegister((offset >> 2) & 15);
    if (offset >= 0x800) return offset & 4 ? (this.channels[(offset - 0x800) >> 6]?.reload ?? 0) : 0;
    throw new Error(`the DMA's register ${offset.toString(16)} is not modelled`);
  }
  writeUint32(offset, v) {
    if (offset < CHANNELS * 64) return this.channels[offset >> 6].writeRegister((offset >> 2) & 15, v);
    const all = (act) => this.channels.filter((c) => v & (1 << c.index)).forEach(act);
    if (offset === 0x430) all((c) => c.trigger());
    else if (offset === 0x444) all((c) => c.abort());
    else throw new Error(`the DMA's register ${offset.toString(16)} is not modelled`);
  }
}
