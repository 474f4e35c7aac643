#!/usr/bin/env node
// decode.mjs ELF --run CYCLES [--cdc HEX] [--bulk HEX]: boots, waits for USB, sends the bytes, runs, and prints what a logic
// analyser on the pins would show: per line the pulses, and histograms of their widths and of the spacings of their starts.

import { parseArgs } from 'node:util';
import { BOARD_OPTIONS, boardOf } from './bench.mjs';

const BOOT_CYCLES = 127.5e6;

/** Pulses of a record of levels: per pin how many, widths and spacings (cycles → how often). */
export function pulses(cycles, levels, length, before = 0) {
  const lines = new Map();
  let last = before;
  for (let i = 0; i < length; i++) {
    for (let changed = last ^ levels[i]; changed; changed &= changed - 1) {
      const g = 31 - Math.clz32(changed & -changed);
      if (!lines.has(g)) lines.set(g, { count: 0, widths: {}, spacings: {}, rise: null });
      const line = lines.get(g);
      if ((levels[i] >>> g) & 1) {
        if (line.rise !== null) tally(line.spacings, cycles[i] - line.rise);
        line.rise = cycles[i];
      } else if (line.rise !== null) {
        line.count++;
        tally(line.widths, cycles[i] - line.rise);
      }
    }
    last = levels[i];
  }
  return new Map([...lines].sort(([a], [b]) => a - b));
}
function tally(histogram, key) {
  histogram[key] = (histogram[key] ?? 0) + 1;
}
const show = (histogram) =>
  Object.entries(histogram)
    .sort(([, a], [, b]) => b - a)
    .slice(0, 6)
    .map(([cycles, n]) => `${cycles}×${n}`)
    .join(' ');

function main() {
  const { positionals, values } = parseArgs({
    allowPositionals: true,
    options: { ...BOARD_OPTIONS, run: { type: 'string', default: '12750000' }, cdc: { type: 'string' }, bulk: { type: 'string' } },
  });
  const board = boardOf(positionals[0], values);
  board.host.setDtr(true);
  board.host.onConfigured = () => board.stop();
  board.run(BOOT_CYCLES);
  board.host.onConfigured = () => {};
  if (!board.host.configured) throw new Error('the firmware did not come up on USB within a second');
  const before = board.recorder.last;
  board.recorder.clear();
  for (const pipe of ['cdc', 'bulk']) if (values[pipe]) board.host.send(pipe, Uint8Array.from(Buffer.from(values[pipe], 'hex')));
  board.run(Number(values.run));
  const { cycles, levels, length } = board.recorder;
  for (const [g, line] of pulses(cycles, levels, length, before))
    console.log(`GP${g}: ${line.count} pulses; widths ${show(line.widths)}; spacings ${show(line.spacings)}`);
  console.log(`${length} changes in ${values.run} cycles`);
}

if (process.argv[1]?.endsWith('decode.mjs')) {
  try {
    main();
  } catch (e) {
    console.error(`decode: ${e.message}`);
    process.exitCode = 1;
  }
}
