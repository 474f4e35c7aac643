// A synthetic boot ROM: the function table that embassy-rp searches, and the few functions that it calls, as Thumb code
// written for this emulator. The flash functions do nothing, because flash.mjs needs no mode change. There is no boot code:
// board.mjs does the ROM's work at reset. A missing function is found as 0, as on the chip.

const BX_LR = 0x4770;

/** Halfwords; r0 table, r1 tag → r0 address or 0. */
const LOOKUP = [
  0x8802, // 0: ldrh r2, [r0]
  0x2a00, //    cmp r2, #0
  0xd003, //    beq 5f
  0x428a, //    cmp r2, r1
  0xd003, //    beq 6f
  0x3004, //    adds r0, #4
  0xe7f8, //    b 0b
  0x2000, // 5: movs r0, #0
  BX_LR,
  0x8840, // 6: ldrh r0, [r0, #2]
  BX_LR,
];
/** r0 destination, r1 source, r2 bytes, a multiple of 4 → r0 unchanged. */
const COPY_WORDS = [
  0x1f12, // 0: subs r2, r2, #4
  0xd302, //    blo 1f
  0x588b, //    ldr r3, [r1, r2]
  0x5083, //    str r3, [r0, r2]
  0xe7fa, //    b 0b
  BX_LR,
];
const COPY_BYTES = [
  0x1e52, // 0: subs r2, r2, #1
  0xd302, //    blo 1f
  0x5c8b, //    ldrb r3, [r1, r2]
  0x5483, //    strb r3, [r0, r2]
  0xe7fa, //    b 0b
  BX_LR,
];
/** r0 destination, r1 byte, r2 bytes. */
const FILL_BYTES = [
  0x1e52, // 0: subs r2, r2, #1
  0xd301, //    blo 1f
  0x5481, //    strb r1, [r0, r2]
  0xe7fb, //    b 0b
  BX_LR,
];

const FUNCTIONS = {
  IF: [BX_LR], // connect_internal_flash
  EX: [BX_LR], // flash_exit_xip
  FC: [BX_LR], // flash_flush_cache
  CX: [BX_LR], // flash_enter_cmd_xip
  MC: COPY_BYTES, // memcpy
  C4: COPY_WORDS, // memcpy44
  MS: FILL_BYTES, // memset
};

export function writeRom(rom) {
  const half = new Uint16Array(rom.buffer);
  half.fill(0);
  half[8] = 0x754d; // 'M', 'u'
  half[9] = 0x0201; // 1, version 2
  let at = 0x40;
  const place = (code) => {
    const address = at;
    half.set(code, at / 2);
    at += 2 * code.length + (code.length % 2) * 2;
    return address;
  };
  const table = Object.entries(FUNCTIONS).flatMap(([tag, code]) => [
    tag.charCodeAt(0) | (tag.charCodeAt(1) << 8),
    place(code) | 1,
  ]);
  half[12] = place(LOOKUP) | 1; // 0x18
  half[11] = place([0]); // 0x16: an empty data table
  half[10] = place([...table, 0]); // 0x14
}
