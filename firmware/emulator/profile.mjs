// Where the core's cycles go: cycles per instruction, and the longest call of each function, both for code in SRAM.
// A call lasts from the function's first instruction to the return to its caller, with all that it calls and with the interrupts in
// between; so does an exception, under the name `exception N`. Inlined functions have no calls. A function that never returns to its caller is left out.

const SRAM = 0x20000000;
const HALFWORDS = 0x80000;

export class Profile {
  /** `symbols` are the ELF's functions by name. */
  constructor(symbols) {
    this.cycles = new Float64Array(HALFWORDS);
    this.names = new Map();
    for (const [name, { address, size }] of symbols) if (size && address >>> 20 === SRAM >>> 20) this.names.set(address, name);
    this.entries = new Uint8Array(HALFWORDS);
    for (const address of this.names.keys()) this.entries[(address - SRAM) >> 1] = 1;
    this.calls = [];
    this.exceptions = [];
    this.longest = new Map();
  }
  /** Counts an instruction at `pc` that took `cycles` and ended at `now`; `r` are the registers after it. */
  count(pc, cycles, r, now) {
    if (pc >>> 20 === SRAM >>> 20) this.cycles[(pc - SRAM) >> 1] += cycles;
    const next = r[15];
    const { calls } = this;
    for (let top = calls.at(-1); top && next === top.back && r[13] === top.sp; top = calls.at(-1)) {
      calls.pop();
      this.lasted(top.name, now - top.from);
    }
    if (next >>> 20 === SRAM >>> 20 && this.entries[(next - SRAM) >> 1])
      calls.push({ name: this.names.get(next), back: r[14] & ~1, sp: r[13], from: now });
  }
  lasted(name, cycles) {
    this.longest.set(name, Math.max(this.longest.get(name) ?? 0, cycles));
  }
  /** The core takes an exception, and returns from one. */
  enter(now) {
    this.exceptions.push(now);
  }
  leave(number, now) {
    const from = this.exceptions.pop();
    if (from !== undefined) this.lasted(`exception ${number}`, now - from);
  }
  result() {
    const instructions = [];
    this.cycles.forEach((cycles, at) => cycles && instructions.push([SRAM + 2 * at, cycles]));
    return { instructions, longest: [...this.longest] };
  }
}
