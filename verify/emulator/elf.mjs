// Reads an ELF32 file: its loadable segments (by physical address, where they lie in flash) and its symbols.
// No relocation, no sections beyond the symbol table, no DWARF.

import fs from 'node:fs';

const PT_LOAD = 1;
const SHT_SYMTAB = 2;
const FUNC = 2;

export function readElf(file) {
  const b = fs.readFileSync(file);
  if (b.length < 52 || b.readUInt32BE(0) !== 0x7f454c46 || b[4] !== 1 || b[5] !== 1) throw new Error(`${file}: not a little-endian ELF32`);
  const table = (offset, size, count) => Array.from({ length: count }, (_, i) => (k) => b.readUInt32LE(offset + i * size + 4 * k));
  const segments = table(b.readUInt32LE(28), b.readUInt16LE(42), b.readUInt16LE(44))
    .filter((word) => word(0) === PT_LOAD && word(4) > 0)
    .map((word) => ({ address: word(3), bytes: b.subarray(word(1), word(1) + word(4)) }));
  const sections = table(b.readUInt32LE(32), b.readUInt16LE(46), b.readUInt16LE(48));
  const symbols = new Map();
  const symtab = sections.find((word) => word(1) === SHT_SYMTAB);
  if (symtab) {
    const names = sections[symtab(6)](4);
    for (let at = symtab(4); at < symtab(4) + symtab(5); at += 16) {
      const start = names + b.readUInt32LE(at);
      const name = b.toString('utf8', start, b.indexOf(0, start));
      if (!name || name.startsWith('$')) continue;
      const isFunction = (b[at + 12] & 15) === FUNC;
      symbols.set(name, { address: b.readUInt32LE(at + 4) & (isFunction ? ~1 : -1), size: b.readUInt32LE(at + 8) });
    }
  }
  return { segments, symbols };
}

/** The symbol whose demangled name ends in `tail`: in Rust's v0 and legacy manglings a name is written after its length. */
export function findByTail(symbols, tail) {
  const mangled = new RegExp(`(^|\\d)${tail}(17h[0-9a-f]{16}E)?$`);
  return [...symbols].find(([name]) => mangled.test(name))?.[1];
}
