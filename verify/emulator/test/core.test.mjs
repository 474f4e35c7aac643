// The core: SysTick to the cycle, preemption by priority, PRIMASK, sleep and its events, faults, a few flags.

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { chip, CODE, load, read, start, write } from './chip.mjs';

const WFE = 0xbf20;
const WFI = 0xbf30;
const SEV = 0xbf40;
const NOP = 0xbf00;
const HERE = 0xe7fe; // b .
const BX_LR = 0x4770;
const CPSID = 0xb672;
const CPSIE = 0xb662;
const SYST_CSR = 0xe000e010;
const ICSR = 0xe000ed04;
const ISER = 0xe000e100;
const ISPR = 0xe000e200;

test('SysTick counts every cycle, reloads after reload + 1, and pends', () => {
  const b = chip();
  write(b, SYST_CSR + 4, 24000 - 1);
  write(b, SYST_CSR + 8, 0);
  write(b, SYST_CSR, 5); // no exception
  const t0 = b.clock.cycle;
  load(b, [HERE]);
  start(b);
  const cvr = () => read(b, SYST_CSR + 8);
  const goTo = (cycle) => {
    b.core.asleep = 1;
    b.runTo(t0 + cycle);
  };
  goTo(1);
  assert.equal(cvr(), 23999);
  goTo(1000);
  assert.equal(cvr(), 23000);
  assert.equal(read(b, SYST_CSR) >>> 16, 0);
  goTo(24000);
  assert.equal(cvr(), 0);
  goTo(24001);
  assert.equal(cvr(), 23999);
  assert.equal(read(b, SYST_CSR) >>> 16, 1, 'COUNTFLAG');
  assert.equal(read(b, SYST_CSR) >>> 16, 0, 'cleared by reading');
  for (let k = 2; k < 50; k++) {
    goTo(24000 * k + 17);
    assert.equal(cvr(), 24000 - 17);
  }
  assert.equal(read(b, ICSR) & (1 << 26), 0);
});

test('SysTick pends behind PRIMASK, and ICSR shows it', () => {
  const b = chip();
  load(b, [CPSID, HERE]);
  start(b);
  write(b, SYST_CSR + 4, 99);
  write(b, SYST_CSR, 7);
  b.run(150);
  assert.equal(read(b, ICSR) & (1 << 26), 1 << 26);
});

test('an interrupt preempts only lower priorities, and equal ones wait', () => {
  const b = chip();
  // SWI 0 (irq 26, priority 2) pends USB (irq 5, priority 0) and SWI 1 (irq 27, priority 2); each handler records itself in r7
  const note = (n) => [0x01bf, 0x3700 | n]; // lsls r7, r7, #6 ; adds r7, #n
  load(b, [0x6021, NOP, NOP, HERE]); // str r1, [r4]
  load(b, [...note(1), 0x6022, NOP, ...note(2), BX_LR], CODE + 0x100); // str r2, [r4]
  load(b, [...note(3), BX_LR], CODE + 0x200);
  load(b, [...note(4), BX_LR], CODE + 0x300);
  start(b, { 42: CODE + 0x100, 21: CODE + 0x200, 43: CODE + 0x300 });
  write(b, 0xe000e400 + 24, 0x80800000); // irqs 26 and 27: priority 2
  write(b, ISER, (1 << 26) | (1 << 27) | (1 << 5));
  b.core.r[1] = 1 << 26;
  b.core.r[2] = (1 << 27) | (1 << 5);
  b.core.r[4] = ISPR | 0;
  b.run(300);
  const order = [18, 12, 6, 0].map((s) => (b.core.r[7] >> s) & 63);
  assert.deepEqual(order, [1, 3, 2, 4]);
  assert.equal(b.core.ipsr, 0);
});

test('SysTick at priority 0 preempts a software interrupt at 2', () => {
  const b = chip();
  load(b, [HERE]);
  load(b, [HERE], CODE + 0x100); // the software interrupt never ends
  load(b, [0x3701, BX_LR], CODE + 0x200); // adds r7, #1
  start(b, { 42: CODE + 0x100, 15: CODE + 0x200 });
  write(b, 0xe000e400 + 24, 0x00800000);
  write(b, ISER, 1 << 26);
  write(b, ISPR, 1 << 26);
  write(b, SYST_CSR + 4, 999);
  write(b, SYST_CSR, 7);
  b.run(10500);
  assert.equal(b.core.r[7], 10);
  assert.equal(b.core.ipsr, 42);
});

test('WFE: an earlier event is not lost, and counts once', () => {
  const b = chip();
  load(b, [SEV, WFE, 0x3701, WFE, 0x3701, HERE]);
  start(b);
  b.run(1000);
  assert.equal(b.core.r[7], 1);
  assert.ok(b.core.counts[1] > 900, 'asleep in the second');
});

test('WFE: an exception wakes the core, also one just before', () => {
  const b = chip();
  load(b, [WFE, 0x3701, 0xe7fc]); // wfe; adds r7, #1; b back
  load(b, [BX_LR], CODE + 0x100);
  start(b, { 42: CODE + 0x100 });
  write(b, ISER, 1 << 26);
  b.run(100);
  const before = b.core.r[7];
  write(b, ISPR, 1 << 26);
  b.run(100);
  // once for the wake-up, once for the event that entry and return leave behind
  assert.equal(b.core.r[7], before + 2);
});

test('WFI under PRIMASK wakes without taking the exception', () => {
  const b = chip();
  load(b, [CPSID, WFI, 0x3701, CPSIE, HERE]);
  load(b, [0x3710, BX_LR], CODE + 0x100); // adds r7, #16
  start(b, { 42: CODE + 0x100 });
  write(b, ISER, 1 << 26);
  b.run(50);
  assert.equal(b.core.r[7], 0);
  write(b, ISPR, 1 << 26);
  b.run(1);
  assert.equal(b.core.r[7], 1);
  b.run(50);
  assert.equal(b.core.r[7], 17);
});

test('a bad access and an undefined instruction are HardFaults; in the handler, lockup', () => {
  for (const program of [[0x6800], [0xde00]]) {
    // ldr r0, [r0]; udf
    const b = chip();
    load(b, [...program, HERE]);
    load(b, [0x3701, HERE], CODE + 0x100);
    start(b, { 3: CODE + 0x100 });
    b.core.r[0] = 0x30000000;
    b.run(100);
    assert.equal(b.core.r[7], 1);
    assert.equal(b.core.ipsr, 3);
    b.hardfault();
    b.run(100);
    assert.ok(b.core.dead);
  }
});

test('flags that the stock interpreter gets wrong', () => {
  const b = chip();
  const run = (op, regs, carry) => {
    load(b, [op, HERE]);
    start(b);
    Object.entries(regs).forEach(([i, v]) => (b.core.r[i] = v));
    b.core.c = carry;
    b.run(1);
    return [b.core.r[0], b.core.c, b.core.v];
  };
  assert.deepEqual(run(0x4148, { 0: 0x7fffffff, 1: 0 }, 1), [-0x80000000, 0, 1]); // adcs: overflow by the carry
  assert.deepEqual(run(0x4088, { 0: 1, 1: 40 }, 1).slice(0, 2), [0, 0]); // lsls by 40
  assert.deepEqual(run(0x40c8, { 0: 5, 1: 0 }, 1).slice(0, 2), [5, 1]); // lsrs by 0 leaves C alone
});

test('STM writes its base back even when it stores it, and 1.5 times slower costs 1.5 times', () => {
  const cost = (slow) => {
    const b = chip({ slow });
    load(b, [0xc103, 0xe7fd]); // stmia r1!, {r0, r1}; b back
    start(b);
    b.core.r[1] = 0x20001000;
    const t0 = b.clock.cycle;
    while (b.instructions < 1000) b.run(1);
    assert.equal(b.core.r[1], 0x20001000 + 8 * 500);
    return b.clock.cycle - t0;
  };
  assert.equal(cost(1), 2500);
  assert.equal(cost(1.5), 3750);
});

test('a missing vector is a lockup, and the bench goes on', () => {
  const b = chip();
  load(b, [0xe7fe]);
  start(b);
  b.core.vtor = 0x30000000;
  write(b, ISER, 1 << 26);
  write(b, ISPR, 1 << 26);
  b.run(100);
  assert.ok(b.core.dead);
});
