// From the ring to the pins: PIO timing, DMA rings and chains, output overrides.

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { chip, idle, levels, read, RING_BASE, setUpPio, setUpRing, TXF0, write } from './chip.mjs';

test('four OUTs a period keep their delays at divider 60, to the cycle', () => {
  const b = chip();
  setUpPio(b);
  for (const w of [7, 3, 0, 0, 5, 1, 0, 0]) write(b, TXF0, w);
  levels(b);
  write(b, 0x50200000, 1);
  idle(b, 5000);
  const seen = levels(b);
  const t0 = seen[0][0];
  assert.deepEqual(seen.map(([c, l]) => [c - t0, l]), [[0, 7], [300, 3], [1200, 0], [1500, 5], [1800, 1], [2700, 0]]);
});

test('a joined FIFO takes eight words, and the OSR a ninth while it runs', () => {
  const b = chip();
  setUpPio(b);
  for (let i = 0; i < 8; i++) write(b, TXF0, 0);
  assert.equal(read(b, 0x50200004) & (1 << 16), 1 << 16, 'TXFULL');
  assert.equal(read(b, 0x5020000c) & 15, 8);
  write(b, 0x50200000, 1);
  idle(b, 100);
  assert.equal(read(b, 0x5020000c) & 15, 6, 'one word on the pins, one in the OSR');
});

test('an empty FIFO stalls the machine, and FDEBUG shows it', () => {
  const b = chip();
  setUpPio(b);
  write(b, TXF0, 1);
  write(b, 0x50200000, 1);
  idle(b, 10000);
  assert.equal(levels(b).at(-1)[1], 1);
  assert.ok(read(b, 0x50200008) & (1 << 24), 'TXSTALL');
  write(b, TXF0, 0);
  idle(b, 200);
  assert.equal(levels(b).at(-1)[1], 0);
});

test('the ring plays for ever, and played words are cleared', () => {
  const b = chip();
  setUpPio(b);
  setUpRing(b);
  for (let i = 0; i < 64; i++) write(b, RING_BASE + 16 * i, 1 << (i % 23)); // every first word of all 64 periods
  levels(b);
  write(b, 0x50000430, 1);
  write(b, 0x50200000, 1);
  idle(b, 1500 * 60 + 750);
  const seen = levels(b);
  const rises = seen.filter(([, l]) => l);
  assert.equal(rises.length, 61);
  rises.forEach(([c, l], i) => assert.deepEqual([c - rises[0][0], l], [1500 * i, 1 << (i % 23)]));
  idle(b, 1500 * 200);
  levels(b);
  for (let i = 0; i < 256; i++) assert.equal(read(b, RING_BASE + 4 * i), 0);
  // long after: both channels still run, within the ring
  write(b, RING_BASE + 16 * 7, 0x155);
  idle(b, 1500 * 64);
  assert.deepEqual(levels(b).map(([, l]) => l), [0x155, 0]);
  const played = read(b, 0x50000000);
  assert.ok(played >= RING_BASE && played < RING_BASE + 1024);
  assert.equal(read(b, 0x502000d4) < 4, true);
  assert.equal(read(b, 0x50200008) & (1 << 24), 0, 'never stalled');
});

test('channels reload their count at each trigger and go on from their addresses', () => {
  const b = chip();
  setUpPio(b);
  setUpRing(b);
  write(b, 0x50000430, 1);
  write(b, 0x50200000, 1);
  idle(b, 1500 * 16);
  assert.ok(read(b, 0x50000044) === RING_BASE + 256, 'one block cleared');
  assert.equal(read(b, 0x50000048), 0);
  assert.ok(read(b, 0x50000008) > 0 && read(b, 0x50000008) <= 64);
  assert.equal(read(b, 0x50000804), 64, 'the reload value');
  assert.equal(read(b, 0x5000000c) & (1 << 24), 1 << 24, 'D busy');
});

test('OUTOVER forces a pin at once while the PIO goes on, and releases it again', () => {
  const b = chip();
  setUpPio(b);
  for (const w of [3, 3, 0, 0]) write(b, TXF0, w);
  write(b, 0x50200000, 1);
  idle(b, 100);
  const at = b.clock.cycle;
  write(b, 0x40014004 + 8, 6 | (2 << 8));
  assert.deepEqual(levels(b).at(-1), [at, 1], 'GP1 low in the same cycle');
  write(b, 0x40014004 + 8, 6 | (3 << 8));
  assert.equal(levels(b).at(-1)[1], 3);
  write(b, 0x40014004 + 8, 6 | (2 << 8));
  idle(b, 300);
  write(b, 0x40014004 + 8, 6);
  assert.equal(levels(b).at(-1)[1], 3, 'released in the middle of the pulse');
  idle(b, 1500);
  assert.equal(levels(b).at(-1)[1], 0);
});

test('an input has the level of its pull', () => {
  const b = chip();
  assert.equal(b.recorder.last, 0);
  write(b, 0x4001c004 + 4 * 3, 0x5a); // PADS: pull-up instead of pull-down
  assert.equal(b.recorder.last, 8);
  assert.equal(read(b, 0xd0000004), 8);
});
