// The levels of the pads GP0..29: drivers, the overrides of IO_BANK0, pulls, and the record of every change.
// rp2040js asks each pin in turn and records no times; here the levels are one word computed with masks.
// From outside only what is connected acts on the pins: see Wiring. Else an input has the level of its pull.

const PINS = 30;
const EDGE_HIGH = 8;
const FUNCTION = { PWM: 4, SIO: 5, PIO0: 6, PIO1: 7 };

/** Levels and the cycles at which they changed, since the last `clear`. Grows; never drops. */
export class Recorder {
  constructor() {
    this.length = 0;
    this.cycles = new Float64Array(1 << 14);
    this.levels = new Uint32Array(1 << 14);
    /** The pads' levels; kept over chip resets. */
    this.last = 0;
  }
  add(cycle, levels) {
    if (levels === this.last) return;
    if (this.length === this.cycles.length) this.grow();
    this.cycles[this.length] = cycle;
    this.levels[this.length++] = levels;
    this.last = levels;
  }
  grow() {
    const cycles = new Float64Array(2 * this.cycles.length);
    const levels = new Uint32Array(2 * this.levels.length);
    cycles.set(this.cycles);
    levels.set(this.levels);
    Object.assign(this, { cycles, levels });
  }
  clear() {
    this.length = 0;
  }
}

/** Faults of the wiring, kept over chip resets: pads held high or low, and pairs that are connected. */
export class Wiring {
  constructor() {
    this.high = this.low = 0;
    this.shorts = [];
    /** Pads that the board itself holds high, unless the chip drives them. */
    this.fed = 0;
  }
  set({ high = 0, low = 0, shorts = [] }) {
    Object.assign(this, { high, low, shorts: shorts.map(([a, b]) => (1 << a) | (1 << b)) });
  }
  /** The levels of pads that are driven so; of two connected outputs the low one wins. */
  levels(value, drive, pullUp) {
    let levels = (value & drive) | ((pullUp | this.fed) & ~drive);
    for (const both of this.shorts) {
      if (!(drive & both)) continue;
      const low = drive & both & ~value;
      levels = low ? levels & ~both : levels | both;
    }
    return (levels | this.high) & ~this.low;
  }
}

export class Pins {
  constructor(mcu, clock, recorder, wiring = new Wiring()) {
    this.wiring = wiring;
    this.mcu = mcu;
    this.clock = clock;
    this.recorder = recorder;
    this.source = new Int32Array(32); // by function number: the pins that it drives
    this.invert = this.low = this.high = 0;
    this.enableInvert = this.disable = this.enable = 0;
    this.pullUp = 0;
    this.input = 0;
    mcu.gpio.forEach((pin, i) => {
      // rp2040js's reset value leaves the input buffer off; the chip's is 0x56
      pin.padValue = 0x56;
      pin.checkForUpdates = () => this.configured(i);
    });
    // GPIO_IN reads the pads, outputs included
    Object.defineProperty(mcu, 'gpioValues', { get: () => this.recorder.last & this.input });
    for (let i = 0; i < PINS; i++) this.configure(i);
    this.update();
  }
  reset() {
    for (const [i, pin] of this.mcu.gpio.entries()) {
      pin.ctrl = 0x1f;
      pin.padValue = 0x56;
      pin.irqStatus = pin.irqEnableMask = pin.irqForceMask = 0;
      this.configure(i);
    }
    this.update();
  }
  /** Rising edges of inputs: latched in INTR of IO_BANK0, whether they are enabled or not. */
  rise(pins) {
    if (!pins) return;
    for (let i = 0; i < PINS; i++) if ((pins >> i) & 1) this.mcu.gpio[i].irqStatus |= EDGE_HIGH;
    this.mcu.updateIOInterrupt();
  }
  configured(i) {
    this.configure(i);
    this.update();
  }
  configure(i) {
    const { ctrl, padValue } = this.mcu.gpio[i];
    const bit = 1 << i;
    const put = (name, on) => {
      this[name] = on ? this[name] | bit : this[name] & ~bit;
    };
    for (const f of Object.values(FUNCTION)) this.source[f] = (ctrl & 31) === f ? this.source[f] | bit : this.source[f] & ~bit;
    const out = (ctrl >> 8) & 3;
    put('invert', out === 1);
    put('low', out === 2);
    put('high', out === 3);
    const enable = (ctrl >> 12) & 3;
    put('enableInvert', enable === 1);
    put('disable', enable === 2 || padValue & 0x80);
    put('enable', enable === 3 && !(padValue & 0x80));
    put('pullUp', (padValue & 0x0c) === 8);
    put('input', padValue & 0x40);
  }
  update() {
    const { mcu, source } = this;
    const [pio0, pio1] = mcu.pio;
    const p0 = source[FUNCTION.PIO0];
    const p1 = source[FUNCTION.PIO1];
    const s = source[FUNCTION.SIO];
    const w = source[FUNCTION.PWM];
    let value = pio0.pinValues & p0;
    let drive = pio0.pinDirections & p0;
    if (p1) {
      value |= pio1.pinValues & p1;
      drive |= pio1.pinDirections & p1;
    }
    if (s) {
      value |= mcu.sio.gpioValue & s;
      drive |= mcu.sio.gpioOutputEnable & s;
    }
    if (w) {
      value |= mcu.pwm.gpioValue & w;
      drive |= mcu.pwm.gpioDirection & w;
    }
    value = ((value ^ this.invert) & ~this.low) | this.high;
    drive = ((drive ^ this.enableInvert) & ~this.disable) | this.enable;
    const levels = this.wiring.levels(value, drive, this.pullUp) >>> 0;
    this.rise(levels & ~this.recorder.last & ~drive & this.input);
    this.recorder.add(this.clock.cycle, levels);
  }
}
