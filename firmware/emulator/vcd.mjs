// Writes the record of the pins as a VCD file, for a wave viewer. Times are nanoseconds of clk_sys at 127.5 MHz. No pin moves
// before the PLL runs.

import fs from 'node:fs';

const PINS = 30;
const name = (g) => String.fromCharCode(33 + g);

export class Vcd {
  constructor(file) {
    this.out = fs.openSync(file, 'w');
    this.last = 0;
    const pins = Array.from({ length: PINS }, (_, g) => g);
    const head = pins.map((g) => `$var wire 1 ${name(g)} GP${g} $end\n`).join('');
    fs.writeSync(this.out, `$timescale 1ns $end\n${head}$enddefinitions $end\n#0\n${pins.map((g) => `0${name(g)}\n`).join('')}`);
  }
  /** Writes the record and empties it. */
  take(recorder, clock) {
    let text = '';
    for (let i = 0; i < recorder.length; i++) {
      const levels = recorder.levels[i];
      text += `#${Math.round(clock.baseNanos + ((recorder.cycles[i] - clock.baseCycle) * 1e9) / clock.hz)}\n`;
      for (let changed = this.last ^ levels; changed; changed &= changed - 1) {
        const g = 31 - Math.clz32(changed & -changed);
        text += `${(levels >>> g) & 1}${name(g)}\n`;
      }
      this.last = levels;
    }
    recorder.clear();
    fs.writeSync(this.out, text);
  }
  close() {
    fs.closeSync(this.out);
  }
}
