// A board without firmware for the self-tests: tests write registers as the core would, and run tiny Thumb programs from SRAM.
// Not a test itself.

import { Board } from '../board.mjs';

export const CODE = 0x20000400;
export const VECTORS = 0x20000000;
const STACK = 0x20020000;

/** clk_sys at 127.5 MHz by the registers, the tick running, everything out of reset. */
export function chip(options = {}) {
  const board = new Board(options);
  setUp(board);
  return board;
}
export function setUp(board) {
  const w = (a, v) => board.bus.write32(a | 0, v);
  w(0x4000c000, 0); // RESETS
  w(0x40028008, 85); // PLL_SYS: 12 MHz × 85 / 8 = 127.5 MHz
  w(0x4002800c, (4 << 16) | (2 << 12));
  w(0x4000803c, 1); // CLK_SYS from the PLL
  w(0x4005802c, 0x200 | 12); // WATCHDOG_TICK
}

export const write = (board, address, value) => board.bus.write32(address | 0, value | 0);
export const read = (board, address) => board.bus.read32(address | 0) >>> 0;

/** Puts halfwords at CODE (or elsewhere) in SRAM. */
export function load(board, halfwords, address = CODE) {
  halfwords.forEach((h, i) => board.bus.write16(address + 2 * i, h));
}
/** Starts the core at CODE with the vectors given as { exception number: address }. */
export function start(board, vectors = {}) {
  for (const [n, address] of Object.entries(vectors)) board.bus.write32(VECTORS + 4 * n, address | 1);
  board.core.vtor = VECTORS;
  board.core.r[13] = STACK;
  board.core.jump(CODE);
}
/** Lets the peripherals run with the core asleep. */
export function idle(board, cycles) {
  board.core.asleep = 1;
  board.core.attention = true;
  board.run(cycles);
}
export function levels(board) {
  const { length, cycles, levels: l } = board.recorder;
  const all = Array.from({ length }, (_, i) => [cycles[i], l[i]]);
  board.recorder.clear();
  return all;
}
/** GP0..22 and 25..28 to PIO0, OUT PINS of 29 from GP0, divider 60, the 5 + 15 + 4 + 1 program, TX FIFO joined. */
export function setUpPio(board) {
  for (const g of [...Array(23).keys(), 25, 26, 27, 28]) write(board, 0x40014004 + 8 * g, 6);
  [0x6400, 0x6e00, 0x6300, 0x6000].forEach((op, i) => write(board, 0x50200048 + 4 * i, op));
  write(board, 0x502000c8, 60 << 16);
  write(board, 0x502000cc, 3 << 12); // wrap from 3 to 0
  write(board, 0x502000d0, (1 << 30) | (1 << 17) | (1 << 19) | (1 << 18));
  write(board, 0x502000dc, 29 << 20);
  // directions, five at a time, as embassy does it
  for (let base = 0; base < 30; base += 5) {
    write(board, 0x502000dc, (5 << 26) | (base << 5));
    write(board, 0x502000d8, 0xe09f);
  }
  write(board, 0x502000dc, 29 << 20);
}
export const RING_BASE = 0x20010000;
export const TXF0 = 0x50200010;
/** Channel 0 plays the ring, channel 1 clears what was played, each starting the other. */
export function setUpRing(board) {
  write(board, 0x50000000, RING_BASE);
  write(board, 0x50000004, TXF0);
  write(board, 0x50000008, 64);
  write(board, 0x50000010, 1 | (2 << 2) | (1 << 4) | (10 << 6) | (1 << 11));
  write(board, 0x50000040, 0x20011000); // a word that stays zero
  write(board, 0x50000044, RING_BASE);
  write(board, 0x50000048, 64);
  write(board, 0x50000050, 1 | (2 << 2) | (1 << 5) | (10 << 6) | (1 << 10) | (0x3f << 15));
}
