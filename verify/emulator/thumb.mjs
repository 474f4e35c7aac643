// The ARMv6-M instruction set as a table: for each 16-bit opcode the number of its operation. Built once, so that the
// interpreter (interpreter.mjs) has one dense switch instead of a chain of tests.
// The numbers are literals here and in the switch: only a switch over literals becomes a jump table.

const PATTERNS = `
1 LSL imm     00000___________ | 2 LSR imm     00001___________ | 3 ASR imm     00010___________
4 ADD reg     0001100_________ | 5 SUB reg     0001101_________ | 6 ADD imm3    0001110_________
7 SUB imm3    0001111_________ | 8 MOV imm     00100___________ | 9 CMP imm     00101___________
10 ADD imm8   00110___________ | 11 SUB imm8   00111___________ | 12 AND        0100000000______
13 EOR        0100000001______ | 14 LSL reg    0100000010______ | 15 LSR reg    0100000011______
16 ASR reg    0100000100______ | 17 ADC        0100000101______ | 18 SBC        0100000110______
19 ROR        0100000111______ | 20 TST        0100001000______ | 21 RSB        0100001001______
22 CMP reg    0100001010______ | 23 CMN        0100001011______ | 24 ORR        0100001100______
25 MUL        0100001101______ | 26 BIC        0100001110______ | 27 MVN        0100001111______
28 ADD high   01000100________ | 29 CMP high   01000101________ | 30 MOV high   01000110________
31 BX         010001110____000 | 32 BLX        010001111____000 | 33 LDR lit    01001___________
34 STR reg    0101000_________ | 35 STRH reg   0101001_________ | 36 STRB reg   0101010_________
37 LDRSB      0101011_________ | 38 LDR reg    0101100_________ | 39 LDRH reg   0101101_________
40 LDRB reg   0101110_________ | 41 LDRSH      0101111_________ | 42 STR imm    01100___________
43 LDR imm    01101___________ | 44 STRB imm   01110___________ | 45 LDRB imm   01111___________
46 STRH imm   10000___________ | 47 LDRH imm   10001___________ | 48 STR sp     10010___________
49 LDR sp     10011___________ | 50 ADR        10100___________ | 51 ADD rd sp  10101___________
52 ADD sp     101100000_______ | 53 SUB sp     101100001_______ | 54 SXTH       1011001000______
55 SXTB       1011001001______ | 56 UXTH       1011001010______ | 57 UXTB       1011001011______
58 PUSH       1011010_________ | 59 CPS        10110110011_0010 | 60 REV        1011101000______
61 REV16      1011101001______ | 62 REVSH      1011101011______ | 63 POP        1011110_________
64 BKPT       10111110________ | 65 NOP        1011111100000000 | 65 YIELD      1011111100010000
66 WFE        1011111100100000 | 67 WFI        1011111100110000 | 68 SEV        1011111101000000
69 STM        11000___________ | 70 LDM        11001___________ | 71 B cond     1101____________
0 UDF         11011110________ | 72 SVC        11011111________ | 73 B          11100___________
74 32-bit     11110___________`;

/** 0 is an undefined instruction. */
export const DECODE = new Uint8Array(65536);
for (const line of PATTERNS.trim().split(/[|\n]/)) {
  const words = line.trim().split(/\s+/);
  const bits = words.at(-1);
  const mask = parseInt(bits.replace(/[01]/g, '1').replace(/_/g, '0'), 2);
  const want = parseInt(bits.replace(/_/g, '0'), 2);
  // a narrower pattern comes after the wider one that contains it
  for (let op = 0; op < 65536; op++) if ((op & mask) === want) DECODE[op] = Number(words[0]);
}
