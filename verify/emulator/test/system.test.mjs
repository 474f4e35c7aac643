// Watchdog, timer, random bits, boot ROM and flash id.

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { chip, CODE, idle, levels, load, read, setUp, setUpPio, start, TXF0, write } from './chip.mjs';

const WATCHDOG = 0x40058000;

test('the watchdog resets the chip after LOAD half-microseconds, keeps the scratch registers, drops the pins', () => {
  const b = chip();
  setUpPio(b);
  write(b, TXF0, 0x1ff);
  write(b, 0x50200000, 1);
  write(b, WATCHDOG + 0x0c, 0xcafe);
  write(b, WATCHDOG + 0x28, 0xf00d);
  write(b, 0x20000100, 0x5eed);
  write(b, WATCHDOG + 4, 2000); // 1 ms, by erratum E1
  write(b, WATCHDOG, 1 << 30);
  const t0 = b.clock.cycle;
  idle(b, 127000);
  assert.equal(b.resets, 0);
  assert.equal(b.recorder.last, 0x1ff);
  levels(b);
  idle(b, 1000);
  assert.equal(b.resets, 1);
  const [[when, level]] = levels(b);
  assert.equal(level, 0);
  assert.ok(Math.abs(when - t0 - 127500) < 130, `${when - t0}`);
  assert.equal(read(b, WATCHDOG + 8), 1, 'REASON.TIMER');
  assert.equal(read(b, WATCHDOG + 0x0c), 0xcafe);
  assert.equal(read(b, WATCHDOG + 0x28), 0xf00d);
  assert.equal(read(b, 0x20000100), 0x5eed, 'SRAM stays');
  assert.equal(read(b, 0x50200000), 0, 'PIO stopped');
  assert.equal(b.clock.hz, 6.5e6, 'back on the ring oscillator');
  assert.ok(b.clock.cycle > t0);
});

test('feeding in time prevents the reset; TRIGGER resets at once', () => {
  const b = chip();
  write(b, WATCHDOG + 4, 2000);
  write(b, WATCHDOG, 1 << 30);
  for (let i = 0; i < 20; i++) {
    idle(b, 100000);
    write(b, WATCHDOG + 4, 2000);
  }
  assert.equal(b.resets, 0);
  write(b, WATCHDOG, (1 << 31) | (1 << 30));
  idle(b, 1);
  assert.equal(b.resets, 1);
  assert.equal(read(b, WATCHDOG + 8), 2, 'REASON.FORCE');
});

test('a dead core is revived by the watchdog only', () => {
  const b = chip();
  load(b, [0x3701, 0xe7fd]); // adds r7, #1; b back
  start(b);
  b.run(1000);
  b.die();
  const { instructions } = b;
  write(b, WATCHDOG + 4, 2000);
  write(b, WATCHDOG, 1 << 30);
  b.run(120000);
  assert.equal(b.instructions, instructions);
  assert.ok(b.core.dead);
  b.run(20000);
  assert.equal(b.resets, 1);
  assert.ok(b.instructions > instructions);
});

test('the RUN pin resets the chip at once, before it runs on', () => {
  const b = chip();
  setUpPio(b);
  write(b, TXF0, 0x1ff);
  write(b, 0x50200000, 1);
  idle(b, 127000);
  assert.equal(b.recorder.last, 0x1ff);
  levels(b);
  const t0 = b.clock.cycle;
  b.runPin();
  idle(b, 60000);
  assert.equal(b.resets, 1);
  const [[when, level]] = levels(b);
  assert.equal(level, 0);
  assert.ok(when - t0 <= 1, `${when - t0}`);
});

test('a timer alarm fires at its microsecond, not before', () => {
  const b = chip();
  load(b, [0xe7fe]);
  load(b, [0x6818, 0x6061, 0xe7fe], CODE + 0x100); // ldr r0, [r3]; str r1, [r4, #4]: acknowledge; stay
  start(b, { 16: CODE + 0x100 });
  b.core.r[3] = 0x40054028;
  b.core.r[4] = 0x40054030;
  b.core.r[1] = 1;
  write(b, 0x40054038, 1);
  write(b, 0xe000e100, 1);
  const target = read(b, 0x40054028) + 7;
  write(b, 0x40054010, target);
  b.run(127 * 6);
  assert.equal(b.core.ipsr, 0);
  b.run(127 * 2);
  assert.equal(b.core.ipsr, 16);
  assert.equal(b.core.r[0], target);
});

test('random bits vary, and repeat with the seed', () => {
  const bits = (seed) => {
    const b = chip({ seed });
    return Array.from({ length: 64 }, () => read(b, 0x4006001c)).join('');
  };
  assert.equal(bits(7), bits(7));
  assert.notEqual(bits(7), bits(8));
  assert.ok(/01/.test(bits(7)) && /10/.test(bits(7)));
});

test('the ROM table has the flash functions, and the SSI answers the unique id', () => {
  const b = chip({ serial: '0102030405060708' });
  const half = (a) => b.bus.read16(a);
  load(b, [0x4790, 0xe7fe]); // blx r2
  start(b);
  const call = (r0, r1, address) => {
    b.core.r.set([r0, r1, address]);
    b.core.jump(CODE);
    b.run(2000);
    return b.core.r[0];
  };
  const find = (tag) => call(half(0x14), tag.charCodeAt(0) | (tag.charCodeAt(1) << 8), half(0x18));
  for (const tag of ['IF', 'EX', 'FC', 'CX', 'C4']) assert.ok(find(tag) & 1, tag);
  assert.equal(find('??'), 0);
  const SSI = 0x18000000;
  write(b, SSI + 8, 0);
  write(b, SSI, 0x300);
  write(b, SSI + 4, 11);
  write(b, SSI + 8, 1);
  b.bus.write8(SSI + 0x60, 0x4b);
  const got = Array.from({ length: 12 }, () => {
    assert.ok(read(b, SSI + 0x28) & 8);
    return b.bus.read8(SSI + 0x60);
  });
  assert.deepEqual(got.slice(4), [1, 2, 3, 4, 5, 6, 7, 8]);
});

test('a chip reset detaches USB, and the clock goes on', () => {
  const b = chip();
  write(b, 0x50110040, 1);
  write(b, 0x5011004c, 1 << 16);
  idle(b, 127500 * 6);
  assert.equal(b.host.state, 'reset');
  write(b, WATCHDOG, 1 << 31);
  const t = b.clock.cycle;
  idle(b, 10);
  assert.equal(b.host.state, 'detached');
  assert.ok(b.clock.cycle >= t);
  setUp(b);
});
