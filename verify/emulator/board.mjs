// The whole emulated Pico: the chip with its corrected parts, the ELF in its flash, the record of the pins, the USB host, resets.
// A chip reset makes a new chip around the old memories. Only SRAM, flash, the watchdog's scratch registers and the clock
// survive, so no state can be left over by mistake.

import { ConsoleLogger, LogLevel, RP2040 } from 'rp2040js';
import { Bus } from './bus.mjs';
import { Clock } from './clock.mjs';
import { Core } from './core.mjs';
import { Dma } from './dma.mjs';
import { findByTail, readElf } from './elf.mjs';
import { Ssi } from './flash.mjs';
import { Pins, Recorder, Wiring } from './pins.mjs';
import { Pio } from './pio.mjs';
import { PrivatePeripherals } from './ppb.mjs';
import { writeRom } from './rom.mjs';
import { ChipId, Crystal, Memory, randomBits, Regulator, Resets, RingOscillator, Tick, Timer, Watchdog } from './system.mjs';
import { UsbDevice } from './usb-device.mjs';
import { UsbHost } from './usb-host.mjs';

/** clk_sys runs from the ring oscillator until the firmware has set up the PLL. */
const ROSC_HZ = 6.5e6;
const FLASH = 0x10000000;
const SRAM = 0x20000000;
/** Where the ROM puts boot2 before it calls it: the end of SRAM5. */
const BOOT2 = 0x20041f00;
const VBUS_SENSE = 1 << 24;
/** CHIP_RESET's flags: why the whole chip was reset last. A watchdog's reset leaves them. */
const HAD_POR = 1 << 8;
const HAD_RUN = 1 << 16;
export const DEFAULT_SERIAL = 'e6614c775b8e3f2a';

function crc32(bytes) {
  let c = 0xffffffff;
  for (const b of bytes) {
    c ^= b << 24;
    for (let i = 0; i < 8; i++) c = c & 0x80000000 ? (c << 1) ^ 0x04c11db7 : c << 1;
  }
  return c >>> 0;
}

export class Board {
  constructor({ elf = null, seed = 1, slow = 1, serial = DEFAULT_SERIAL, revision = 2, pioLate = 0, vbusSense = false } = {}) {
    this.clock = new Clock(ROSC_HZ);
    this.recorder = new Recorder();
    this.wiring = new Wiring();
    this.host = new UsbHost(this.clock);
    if (vbusSense) this.host.onCable = () => this.cable();
    this.random = randomBits(seed);
    this.slow = slow;
    this.revision = revision;
    this.pioLate = pioLate;
    this.uniqueId = [...Buffer.from(serial, 'hex')];
    this.kept = { scratch: new Uint32Array(8), reason: 0, chipReset: HAD_POR };
    this.past = { instructions: 0, asleep: 0 };
    this.resets = 0;
    this.resetWanted = false;
    this.stopWanted = false;
    this.segments = [];
    this.symbols = new Map();
    this.build();
    if (elf) {
      ({ segments: this.segments, symbols: this.symbols } = readElf(elf));
      this.boot();
    }
  }

  // ---- the chip

  build() {
    const old = this.mcu;
    this.clock.clear();
    const mcu = new RP2040(this.clock);
    mcu.logger = new ConsoleLogger(LogLevel.Error, false);
    // rp2040js starts at 125 MHz; the real chip starts from the ring oscillator
    mcu.clkSys = ROSC_HZ;
    this.clock.setFrequency(ROSC_HZ);
    mcu.addClockListener((hz) => this.clock.setFrequency(hz));
    if (old) {
      const { sram, sramView, flash, flash16, flashView } = old;
      Object.assign(mcu, { sram, sramView, flash, flash16, flashView });
    }
    writeRom(mcu.bootrom);
    this.bus = mcu.bus = new Bus(mcu);
    this.core = mcu.core = new Core(this.clock, this.bus, this.slow);
    this.bus.ppb = mcu.ppb = new PrivatePeripherals(this.core, this.clock);
    mcu.dma = new Dma(mcu, 'DMA');
    mcu.pio = [new Pio(mcu, 'PIO0', 7, 0, this.pioLate), new Pio(mcu, 'PIO1', 9, 1, this.pioLate)];
    mcu.pins = new Pins(mcu, this.clock, this.recorder, this.wiring);
    mcu.usbCtrl = new UsbDevice(mcu);
    const tick = new Tick(this.clock);
    const timer = new Timer(mcu, tick);
    const at = (base, peripheral) => {
      mcu.peripherals[(base >>> 14) << 2] = peripheral;
    };
    at(0x14000000, new Memory(mcu, 'XIP_CTRL'));
    at(0x18000000, new Ssi(mcu, this.uniqueId));
    at(0x4000c000, new Resets(mcu, [
      [2, () => mcu.dma.reset()],
      [5, () => mcu.pins.reset()],
      [8, () => mcu.pins.reset()],
      [10, () => mcu.pio[0].reset()],
      [11, () => mcu.pio[1].reset()],
      [24, () => mcu.usbCtrl.reset()],
    ]));
    at(0x40000000, new ChipId(mcu, this.revision));
    at(0x40018000, new Memory(mcu, 'IO_QSPI'));
    at(0x40024000, new Crystal(mcu));
    at(0x40054000, timer);
    at(0x40058000, new Watchdog(mcu, tick, this.kept, () => this.wantReset()));
    at(0x40060000, new RingOscillator(mcu, this.random));
    at(0x40064000, new Regulator(mcu, this.kept));
    at(0x50000000, mcu.dma);
    at(0x50110000, mcu.usbCtrl);
    at(0x50200000, mcu.pio[0]);
    at(0x50300000, mcu.pio[1]);
    this.mcu = mcu;
    this.host.connect(mcu.usbCtrl);
    this.host.onCable();
  }
  /** A Pico leads VBUS to GP24, divided. */
  cable() {
    this.wiring.fed = this.host.plugged ? VBUS_SENSE : 0;
    this.mcu.pins.update();
  }

  /** Does what the ROM does at reset: checks boot2, copies it to SRAM and calls it. */
  boot() {
    const { mcu, core } = this;
    for (const { address, bytes } of this.segments) {
      if (address >= FLASH && address + bytes.length <= FLASH + mcu.flash.length) mcu.flash.set(bytes, address - FLASH);
      else if (address >>> 24 !== 0x20) throw new Error(`segment at ${address.toString(16)}, which is not flash`);
    }
    const boot2 = mcu.flash.subarray(0, 256);
    if (crc32(boot2.subarray(0, 252)) !== mcu.flashView.getUint32(252, true)) throw new Error('boot2 checksum: a real RP2040 would stay in BOOTSEL');
    mcu.sram.set(boot2, BOOT2 - SRAM);
    core.r[13] = BOOT2;
    core.r[14] = 0; // 0 tells boot2 to continue at the vector table
    core.r[15] = BOOT2;
  }
  wantReset() {
    this.resetWanted = true;
    this.core.stop();
  }
  reset() {
    this.resetWanted = false;
    this.resets++;
    this.past.instructions += this.core.counts[0];
    this.past.asleep += this.core.counts[1];
    this.build();
    if (this.segments.length) this.boot();
  }

  // ---- running

  /** Runs to the given cycle, over resets; `stop` ends it sooner. */
  runTo(limit) {
    this.stopWanted = false;
    while (this.clock.cycle < limit && !this.stopWanted) {
      // The RUN pin may have been pulled between two runs, and the core forgets that it was told to stop.
      if (this.resetWanted) this.reset();
      this.core.run(limit);
      if (this.resetWanted) this.reset();
    }
  }
  run(cycles) {
    this.runTo(this.clock.cycle + cycles);
  }
  /** Called by callbacks: ends the run after the current instruction. */
  stop() {
    this.stopWanted = true;
    this.core.stop();
  }
  get instructions() {
    return this.past.instructions + this.core.counts[0];
  }
  get asleep() {
    return this.past.asleep + this.core.counts[1];
  }

  // ---- faults and memory

  die() {
    this.core.die();
  }
  panic() {
    const handler = findByTail(this.symbols, 'rust_begin_unwind');
    if (!handler) throw new Error('no symbol rust_begin_unwind in the ELF (stripped, or the panic handler was inlined)');
    this.core.r[0] = 0;
    this.core.jump(handler.address);
  }
  /** The RUN pin goes low for a moment: unlike a watchdog's reset, this clears SCRATCH and REASON. */
  runPin() {
    Object.assign(this.kept, { scratch: new Uint32Array(8), reason: 0, chipReset: HAD_RUN });
    this.wantReset();
  }
  hardfault() {
    this.core.hardFault();
  }
  symbol(name) {
    const s = this.symbols.get(name);
    if (!s) throw new Error(`no symbol ${name} in the ELF`);
    return s;
  }
  memory(name, length) {
    const { address } = this.symbol(name);
    const { mcu } = this;
    const [bytes, base] = address >>> 24 === 0x20 ? [mcu.sram, SRAM] : [mcu.flash, FLASH];
    if (address < base || address + length > base + bytes.length) throw new Error(`${name} at ${address.toString(16)}: ${length} bytes leave the memory`);
    return bytes.subarray(address - base, address - base + length);
  }
}
