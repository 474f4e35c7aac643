// The PIO blocks in time: state machines that step on their divided clock, with delays, joined FIFOs and autopull.
// rp2040js executes the instructions, but without a clock. `OUT PINS, 32` with autopull is executed here: the firmware runs it
// 340 000 times a second. A waiting machine costs no time: an event wakes it, and it continues at its next own clock tick.
// Not modelled: OUT_STICKY, INLINE_OUT_EN, the input synchronisers.

import { FIFO, RPPIO, StateMachine } from 'rp2040js';

const OUT_PINS_32 = 0x6000;
const DELAY_MASK = 0x1f00;
const AUTOPULL = 1 << 17;
const PULL_THRESHOLD = 0x1f << 25;
const JOIN_TX = 1 << 30;
const JOIN_RX = 1 << 31;
const TX_OVER = 1 << 16;
const TX_STALL = 1 << 24;

class Machine extends StateMachine {
  constructor(...args) {
    super(...args);
    this.at = 0; // cycle of its next step; a fraction if the divider has one
    this.resting = false; // waiting or stalled
    this.outStalled = false;
    this.stepping = false;
    this.outputShiftCount = 32; // the OSR is empty out of reset
    this.divider = 1;
    this.fast = false;
    this.txAddress = 0x50200010 + 0x100000 * this.pio.index + 4 * this.index;
  }
  // the DMA looks at the FIFOs itself
  updateDMATx() {
    if (!this.txFIFO.full) this.rp2040.dma.requested(this.dreqTx);
  }
  updateDMARx() {
    if (!this.rxFIFO.empty) this.rp2040.dma.requested(this.dreqRx);
  }
  get osrEmpty() {
    return this.outputShiftCount >= this.pullThreshold;
  }
  writeFIFO(value) {
    const { pio, txFIFO } = this;
    if (txFIFO.full) {
      pio.fdebug |= TX_OVER << this.index;
      return;
    }
    txFIFO.push(value);
    pio.txStall &= ~(TX_STALL << this.index);
    this.updateDMATx();
    if (this.resting) this.checkWait();
    if (pio.irq0IntEnable | pio.irq1IntEnable) pio.checkInterrupts();
    // the OSR refills by itself unless an OUT is already waiting for it
    if (this.fast && this.enabled && !this.outStalled && this.osrEmpty) this.refill();
  }
  refill() {
    if (this.txFIFO.used === 0) return;
    this.outputShiftReg = this.txFIFO.pull();
    this.outputShiftCount = 0;
    this.rp2040.dma.requested(this.dreqTx);
    if (this.pio.irq0IntEnable | this.pio.irq1IntEnable) this.pio.checkInterrupts();
  }
  clkDivRestart() {
    if (!this.enabled || this.resting) this.at = this.rp2040.clock.cycle;
  }
  restart() {
    super.restart();
    this.resting = this.outStalled = false;
    this.realign();
  }
  start() {
    this.at = this.rp2040.clock.cycle + 1 + this.pio.late;
    this.resting = this.outStalled = false;
  }
  /** Moves on to its next own clock tick after a wait. */
  realign() {
    const now = this.rp2040.clock.cycle;
    if (this.at <= now) this.at += (Math.floor((now - this.at) / this.divider) + 1) * this.divider;
  }
  writeUint32(offset, value) {
    const joins = this.shiftCtrl ^ value;
    super.writeUint32(offset, value);
    if (offset === 0) this.divider = (this.clockDivInt || 65536) + this.clockDivFrac / 256;
    if (offset === 8 && joins & (JOIN_TX | JOIN_RX)) {
      // changing FJOIN flushes both FIFOs
      this.txFIFO = new FIFO(value & JOIN_RX ? 0 : value & JOIN_TX ? 8 : 4);
      this.rxFIFO = new FIFO(value & JOIN_TX ? 0 : value & JOIN_RX ? 8 : 4);
      this.updateDMATx();
    }
    this.fast = (this.shiftCtrl & (AUTOPULL | PULL_THRESHOLD)) === AUTOPULL && this.sidesetCount === 0;
  }
  /** rp2040js calls this whenever a condition that a machine may wait for has changed. */
  checkWait() {
    if (this.stepping) return super.checkWait();
    if (!this.resting || !(this.waiting || this.outStalled)) return;
    this.resting = false;
    this.realign();
    this.pio.arm();
  }
  step() {
    const op = this.pio.instructions[this.pc];
    if ((op & ~DELAY_MASK) === OUT_PINS_32 && this.fast && !this.waiting) return this.outPins((op & DELAY_MASK) >> 8);
    this.stepping = true;
    const before = this.cycles;
    if (this.waiting) super.checkWait();
    else {
      this.updatePC = true;
      this.executeInstruction(op);
      if (this.updatePC) this.nextPC();
    }
    this.stepping = false;
    if (this.waiting) this.resting = true;
    // an instruction that has waited takes its own cycle now
    else this.at += Math.max(1, this.cycles - before) * this.divider;
  }
  outPins(delay) {
    const { pio } = this;
    const stall = TX_STALL << this.index;
    if (this.outputShiftCount >= 32) {
      if (this.txFIFO.used === 0) {
        pio.txStall |= stall;
        pio.fdebug |= stall;
        this.outStalled = this.resting = true;
        return;
      }
      // the refill of an OSR that ran dry takes a tick of its own
      this.outStalled = false;
      pio.txStall &= ~stall;
      this.refill();
      this.at += this.divider;
      return;
    }
    pio.pinValuesChanged(this.outputShiftReg, this.pinCtrl & 31, (this.pinCtrl >> 20) & 63);
    this.outputShiftCount = 32;
    this.refill();
    this.nextPC();
    this.at += (1 + delay) * this.divider;
  }
}

export class Pio extends RPPIO {
  /** `late`: cycles by which the first clock of a machine comes later than here. */
  constructor(rp2040, name, firstIrq, index, late = 0) {
    super(rp2040, name, firstIrq, index);
    this.late = late;
    this.reset();
  }
  reset() {
    this.alarm?.cancel();
    this.alarm = this.rp2040.clock.createAlarm(() => this.fire());
    this.machines = [0, 1, 2, 3].map((i) => new Machine(this.rp2040, this, i));
    this.stopped = true;
    this.instructions.fill(0);
    this.fdebug = this.txStall = this.rxStall = this.irq = 0;
    this.irq0IntEnable = this.irq0IntForce = this.irq1IntEnable = this.irq1IntForce = 0;
    this.pinValues = this.pinDirections = 0;
  }
  run() {} // stock: free-running on setTimeout
  arm() {
    let first = Infinity;
    for (const m of this.machines) if (m.enabled && !m.resting && m.at < first) first = m.at;
    if (first === Infinity) this.alarm.cancel();
    else this.alarm.scheduleAt(Math.ceil(first));
  }
  fire() {
    const now = this.rp2040.clock.cycle;
    for (const m of this.machines) if (m.enabled && !m.resting && m.at <= now) m.step();
    this.rp2040.pins.update();
    this.arm();
  }
  writeUint32(offset, value) {
    const was = offset === 0 ? this.machines.map((m) => m.enabled) : null;
    super.writeUint32(offset, value);
    if (was) this.machines.forEach((m, i) => m.enabled && !was[i] && m.start());
    if (offset < 0x10 || offset > 0x1c) {
      this.arm();
      this.rp2040.pins.update(); // forced instructions, e.g. set pindirs
    }
  }
  readUint32(offset) {
    // the instruction memory is write-only
    return offset >= 0x48 && offset <= 0xc4 ? 0 : super.readUint32(offset);
  }
}
