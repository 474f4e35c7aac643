// The ARMv6-M instructions: registers, flags, and the effect and cycles of each opcode. It replaces rp2040js's interpreter,
// which is slow and gets flags (ADCS, SBCS, shifts by register) and STM write-back wrong. The core (core.mjs) extends this
// class with exceptions and sleep. Cycles are the TRM's for zero-wait memory.

import { Fault } from './bus.mjs';
import { SVCALL } from './exceptions.mjs';
import { DECODE } from './thumb.mjs';

export const WFI = 1;
export const WFE = 2;
// by the top four address bits: APB behind its bridge is slow, SIO is single-cycle
const READ_CYCLES = new Uint8Array([2, 2, 2, 2, 4, 2, 2, 2, 2, 2, 2, 2, 2, 1, 2, 2]);
const WRITE_CYCLES = new Uint8Array([2, 2, 2, 2, 5, 2, 2, 2, 2, 2, 2, 2, 2, 1, 2, 2]);

export class Interpreter {
  constructor(bus) {
    this.bus = bus;
    this.r = new Int32Array(16); // r[15] is the address of the next instruction
    this.result = 0; // N and Z are those of this value
    this.c = 0;
    this.v = 0;
    this.primask = 0;
    this.ipsr = 0;
    this.event = false;
    /** The core must look at something besides the next instruction. */
    this.attention = false;
  }

  get psr() {
    return (this.result & 0x80000000) | (this.result === 0 ? 1 << 30 : 0) | (this.c << 29) | (this.v << 28) | (1 << 24) | this.ipsr;
  }
  set flags(psr) {
    // N and Z together cannot come from a result; Z wins
    this.result = psr & (1 << 30) ? 0 : psr & (1 << 31) ? -1 : 1;
    this.c = (psr >>> 29) & 1;
    this.v = (psr >>> 28) & 1;
  }
  // ---- special registers

  readSpecial(which) {
    if (which <= 7) return (which & 4 ? 0 : this.psr & 0xf0000000) | (which & 1 ? this.ipsr : 0);
    if (which === 8) return this.r[13];
    if (which === 16) return this.primask;
    throw new Error(`the special register ${which} is not modelled`);
  }
  writeSpecial(which, value) {
    if (which <= 3) this.flags = value;
    else if (which === 8) this.r[13] = value & ~3;
    else if (which === 16) {
      this.primask = value & 1;
      this.attention = true;
    } else throw new Error(`the special register ${which} is not modelled`);
  }

  // ---- arithmetic that sets the flags

  add(a, b, carry) {
    const sum = (a + b + carry) | 0;
    this.c = ((a & b) | ((a | b) & ~sum)) >>> 31;
    this.v = ((a ^ sum) & (b ^ sum)) >>> 31;
    this.result = sum;
    return sum;
  }

  /** One instruction; returns its cycles. */
  step() {
    const { r, bus } = this;
    const pc = r[15];
    const op = bus.fetch(pc);
    r[15] = pc + 2;
    const d = op & 7;
    const m = (op >> 3) & 7;
    const n = (op >> 6) & 7;
    const d8 = (op >> 8) & 7;
    const imm5 = (op >> 6) & 31;
    const imm8 = op & 255;
    let a = 0;
    let b = 0;
    switch (DECODE[op]) {
      case 1: // LSLS Rd, Rm, #imm5
        a = r[m];
        if (imm5) this.c = (a >>> (32 - imm5)) & 1;
        this.result = r[d] = a << imm5;
        return 1;
      case 2: // LSRS Rd, Rm, #imm5, where 0 stands for 32
        a = r[m];
        this.c = (a >>> ((imm5 || 32) - 1)) & 1;
        this.result = r[d] = imm5 ? a >>> imm5 : 0;
        return 1;
      case 3: // ASRS Rd, Rm, #imm5
        a = r[m];
        this.c = (a >>> ((imm5 || 32) - 1)) & 1;
        this.result = r[d] = a >> (imm5 || 31);
        return 1;
      case 4:
        r[d] = this.add(r[m], r[n], 0);
        return 1;
      case 5:
        r[d] = this.add(r[m], ~r[n], 1);
        return 1;
      case 6:
        r[d] = this.add(r[m], n, 0);
        return 1;
      case 7:
        r[d] = this.add(r[m], ~n, 1);
        return 1;
      case 8:
        this.result = r[d8] = imm8;
        return 1;
      case 9:
        this.add(r[d8], ~imm8, 1);
        return 1;
      case 10:
        r[d8] = this.add(r[d8], imm8, 0);
        return 1;
      case 11:
        r[d8] = this.add(r[d8], ~imm8, 1);
        return 1;
      case 12:
        this.result = r[d] &= r[m];
        return 1;
      case 13:
        this.result = r[d] ^= r[m];
        return 1;
      case 14: // LSLS Rdn, Rm
        a = r[d];
        b = r[m] & 255;
        if (b) this.c = b > 32 ? 0 : (a >>> (32 - b)) & 1;
        this.result = r[d] = b > 31 ? 0 : a << b;
        return 1;
      case 15: // LSRS Rdn, Rm
        a = r[d];
        b = r[m] & 255;
        if (b) this.c = b > 32 ? 0 : (a >>> (b - 1)) & 1;
        this.result = r[d] = b > 31 ? 0 : a >>> b;
        return 1;
      case 16: // ASRS Rdn, Rm
        a = r[d];
        b = Math.min(r[m] & 255, 32);
        if (b) this.c = (a >> Math.min(b - 1, 31)) & 1;
        this.result = r[d] = a >> Math.min(b, 31);
        return 1;
      case 17:
        r[d] = this.add(r[d], r[m], this.c);
        return 1;
      case 18:
        r[d] = this.add(r[d], ~r[m], this.c);
        return 1;
      case 19: // RORS
        a = r[d];
        b = r[m] & 255;
        if (b) {
          a = (a >>> (b & 31)) | (a << ((32 - b) & 31));
          this.c = a >>> 31;
        }
        this.result = r[d] = a;
        return 1;
      case 20:
        this.result = r[d] & r[m];
        return 1;
      case 21:
        r[d] = this.add(0, ~r[m], 1);
        return 1;
      case 22:
        this.add(r[d], ~r[m], 1);
        return 1;
      case 23:
        this.add(r[d], r[m], 0);
        return 1;
      case 24:
        this.result = r[d] |= r[m];
        return 1;
      case 25:
        this.result = r[d] = Math.imul(r[d], r[m]);
        return 1;
      case 26:
        this.result = r[d] &= ~r[m];
        return 1;
      case 27:
        this.result = r[d] = ~r[m];
        return 1;
      case 28: // ADD Rdn, Rm, any registers
      case 29:
      case 30: {
        const rd = d | ((op >> 4) & 8);
        const rm = (op >> 3) & 15;
        b = rm === 15 ? pc + 4 : r[rm];
        a = rd === 15 ? pc + 4 : r[rd];
        if ((op & 0x300) === 0x100) {
          this.add(a, ~b, 1);
          return 1;
        }
        a = (op & 0x300) === 0 ? a + b : b;
        if (rd === 15) {
          r[15] = a & ~1;
          return 2;
        }
        r[rd] = rd === 13 ? a & ~3 : a;
        return 1;
      }
      case 31:
        return 2 + this.branch(r[(op >> 3) & 15]);
      case 32:
        a = r[(op >> 3) & 15];
        r[14] = (pc + 2) | 1;
        return 2 + this.branch(a);
      case 33:
        r[d8] = bus.read32(((pc + 4) & ~3) + imm8 * 4);
        return 2;
      case 34:
        a = (r[m] + r[n]) | 0;
        bus.write32(a, r[d]);
        return WRITE_CYCLES[a >>> 28];
      case 35:
        a = (r[m] + r[n]) | 0;
        bus.write16(a, r[d]);
        return WRITE_CYCLES[a >>> 28];
      case 36:
        a = (r[m] + r[n]) | 0;
        bus.write8(a, r[d]);
        return WRITE_CYCLES[a >>> 28];
      case 37:
        a = (r[m] + r[n]) | 0;
        r[d] = (bus.read8(a) << 24) >> 24;
        return READ_CYCLES[a >>> 28];
      case 38:
        a = (r[m] + r[n]) | 0;
        r[d] = bus.read32(a);
        return READ_CYCLES[a >>> 28];
      case 39:
        a = (r[m] + r[n]) | 0;
        r[d] = bus.read16(a);
        return READ_CYCLES[a >>> 28];
      case 40:
        a = (r[m] + r[n]) | 0;
        r[d] = bus.read8(a);
        return READ_CYCLES[a >>> 28];
      case 41:
        a = (r[m] + r[n]) | 0;
        r[d] = (bus.read16(a) << 16) >> 16;
        return READ_CYCLES[a >>> 28];
      case 42:
        a = (r[m] + imm5 * 4) | 0;
        bus.write32(a, r[d]);
        return WRITE_CYCLES[a >>> 28];
      case 43:
        a = (r[m] + imm5 * 4) | 0;
        r[d] = bus.read32(a);
        return READ_CYCLES[a >>> 28];
      case 44:
        a = (r[m] + imm5) | 0;
        bus.write8(a, r[d]);
        return WRITE_CYCLES[a >>> 28];
      case 45:
        a = (r[m] + imm5) | 0;
        r[d] = bus.read8(a);
        return READ_CYCLES[a >>> 28];
      case 46:
        a = (r[m] + imm5 * 2) | 0;
        bus.write16(a, r[d]);
        return WRITE_CYCLES[a >>> 28];
      case 47:
        a = (r[m] + imm5 * 2) | 0;
        r[d] = bus.read16(a);
        return READ_CYCLES[a >>> 28];
      case 48:
        bus.write32((r[13] + imm8 * 4) | 0, r[d8]);
        return 2;
      case 49:
        r[d8] = bus.read32((r[13] + imm8 * 4) | 0);
        return 2;
      case 50:
        r[d8] = ((pc + 4) & ~3) + imm8 * 4;
        return 1;
      case 51:
        r[d8] = r[13] + imm8 * 4;
        return 1;
      case 52:
        r[13] += (op & 127) * 4;
        return 1;
      case 53:
        r[13] -= (op & 127) * 4;
        return 1;
      case 54:
        r[d] = (r[m] << 16) >> 16;
        return 1;
      case 55:
        r[d] = (r[m] << 24) >> 24;
        return 1;
      case 56:
        r[d] = r[m] & 0xffff;
        return 1;
      case 57:
        r[d] = r[m] & 0xff;
        return 1;
      case 58:
        return this.push(op);
      case 59: // CPSIE i, CPSID i
        this.primask = (op >> 4) & 1;
        this.attention = true;
        return 1;
      case 60:
        a = r[m];
        r[d] = (a >>> 24) | ((a >>> 8) & 0xff00) | ((a & 0xff00) << 8) | (a << 24);
        return 1;
      case 61:
        a = r[m];
        r[d] = ((a >>> 8) & 0xff00ff) | ((a & 0xff00ff) << 8);
        return 1;
      case 62:
        a = r[m];
        r[d] = (((a & 0xff) << 24) >> 16) | ((a >>> 8) & 0xff);
        return 1;
      case 63:
        return this.pop(op);
      case 64:
        r[15] = pc;
        throw new Fault('BKPT without a debugger');
      case 65:
        return 1;
      case 66: // WFE
        if (this.event) this.event = false;
        else this.sleep(WFE);
        return 2;
      case 67:
        this.sleep(WFI);
        return 2;
      case 68: // SEV
        this.event = true;
        return 1;
      case 69: // STMIA
        a = r[d8];
        for (b = 0; b < 8; b++)
          if (op & (1 << b)) {
            bus.write32(a, r[b]);
            a += 4;
          }
        b = ((a - r[d8]) >> 2) + 1;
        r[d8] = a;
        return b;
      case 70:
        return this.loadMany(op, d8, r[d8]);
      case 71:
        if (!this.holds((op >> 8) & 15)) return 1;
        r[15] = pc + 4 + ((imm8 << 24) >> 23);
        return 2;
      case 72:
        this.exceptions.pendSystem(SVCALL);
        return 1;
      case 73:
        r[15] = pc + 4 + ((op << 21) >> 20);
        return 2;
      case 74:
        return this.wide(op, pc);
      default:
        r[15] = pc;
        throw new Fault('undefined instruction');
    }
  }

  holds(condition) {
    const { result } = this;
    switch (condition) {
      case 0:
        return result === 0;
      case 1:
        return result !== 0;
      case 2:
        return this.c === 1;
      case 3:
        return this.c === 0;
      case 4:
        return result < 0;
      case 5:
        return result >= 0;
      case 6:
        return this.v === 1;
      case 7:
        return this.v === 0;
      case 8:
        return this.c === 1 && result !== 0;
      case 9:
        return this.c === 0 || result === 0;
      case 10:
        return result >>> 31 === this.v;
      case 11:
        return result >>> 31 !== this.v;
      case 12:
        return result !== 0 && result >>> 31 === this.v;
      default:
        return result === 0 || result >>> 31 !== this.v;
    }
  }

  push(op) {
    const { r, bus } = this;
    let count = 0;
    for (let m = op & 0x1ff; m; m &= m - 1) count++;
    let a = r[13] - 4 * count;
    r[13] = a;
    for (let i = 0; i < 8; i++)
      if (op & (1 << i)) {
        bus.write32(a, r[i]);
        a += 4;
      }
    if (op & 0x100) bus.write32(a, r[14]);
    return 1 + count;
  }
  pop(op) {
    const { r, bus } = this;
    let a = r[13];
    for (let i = 0; i < 8; i++)
      if (op & (1 << i)) {
        r[i] = bus.read32(a);
        a += 4;
      }
    const cost = 1 + ((a - r[13]) >> 2);
    if (!(op & 0x100)) {
      r[13] = a;
      return cost;
    }
    const target = bus.read32(a);
    r[13] = a + 4;
    return cost + 3 + this.branch(target);
  }
  loadMany(op, base, address) {
    const { r, bus } = this;
    let a = address;
    for (let i = 0; i < 8; i++)
      if (op & (1 << i)) {
        r[i] = bus.read32(a);
        a += 4;
      }
    if (!(op & (1 << base))) r[base] = a;
    return 1 + ((a - address) >> 2);
  }

  /** BL, MRS, MSR, barriers: all the 32-bit instructions there are. */
  wide(op, pc) {
    const { r } = this;
    const low = this.bus.fetch(pc + 2);
    r[15] = pc + 4;
    if ((low & 0xd000) === 0xd000) {
      const s = (op >> 10) & 1;
      const i1 = 1 ^ s ^ ((low >> 13) & 1);
      const i2 = 1 ^ s ^ ((low >> 11) & 1);
      r[14] = (pc + 4) | 1;
      r[15] = pc + 4 + (((s << 24) | (i1 << 23) | (i2 << 22) | ((op & 0x3ff) << 12) | ((low & 0x7ff) << 1)) << 7 >> 7);
      return 3;
    }
    if (op === 0xf3ef && low >> 12 === 8) {
      r[(low >> 8) & 15] = this.readSpecial(low & 255);
      return 3;
    }
    if ((op & 0xfff0) === 0xf380 && low >> 8 === 0x88) {
      this.writeSpecial(low & 255, r[op & 15]);
      return 3;
    }
    if (op === 0xf3bf && (low & 0xff00) === 0x8f00) return 3; // DSB, DMB, ISB: memory is in order here
    r[15] = pc;
    throw new Fault('undefined instruction');
  }
}
