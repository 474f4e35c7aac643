// The flash chip behind the SSI: the commands that boot2 and embassy-rp send it (status, JEDEC id, unique id), byte by byte.
// Reads through XIP do not pass here. Erase and program are missing: the firmware never uses them.

import { BasePeripheral } from 'rp2040js';

const STATUS = { IDLE: 0x04 | 0x02, RX_NOT_EMPTY: 0x08 }; // TFE, TFNF; RFNE
const EEPROM_READ = 3;
const JEDEC = [0xef, 0x70, 0x15]; // W25Q16JV, as on a Pico

class FlashChip {
  constructor(uniqueId) {
    this.uniqueId = uniqueId;
    this.quadEnabled = 0;
    this.command = [];
  }
  deselect() {
    if (this.command[0] === 0x01) this.quadEnabled = this.command[2] & 2;
    this.command = [];
  }
  /** One byte in, one byte out. */
  exchange(byte) {
    const at = this.command.push(byte) - 1;
    switch (this.command[0]) {
      case 0x05: // status 1: never busy
        return 0;
      case 0x35:
        return at ? this.quadEnabled : 0;
      case 0x9f:
        return at ? (JEDEC[at - 1] ?? 0) : 0;
      case 0x4b: // four dummy bytes come before the id
        return at >= 5 ? (this.uniqueId[at - 5] ?? 0) : 0;
      default:
        return 0;
    }
  }
}

export class Ssi extends BasePeripheral {
  constructor(rp2040, uniqueId) {
    super(rp2040, 'SSI');
    this.chip = new FlashChip(uniqueId);
    this.words = new Map([[0x58, 0x51535049], [0x5c, 0x3430312a]]);
    this.received = [];
    this.toRead = 0;
  }
  get mode() {
    return ((this.words.get(0) ?? 0) >> 8) & 3;
  }
  /** In EEPROM-read mode CTRLR1 + 1 frames follow by themselves after the command. */
  clockIn() {
    while (this.toRead > 0) {
      this.received.push(this.chip.exchange(0));
      this.toRead--;
    }
  }
  readUint32(offset) {
    if (offset === 0x28) {
      this.clockIn();
      return STATUS.IDLE | (this.received.length ? STATUS.RX_NOT_EMPTY : 0);
    }
    if (offset === 0x24) return this.received.length;
    if (offset === 0x20) return 0;
    if (offset >= 0x60 && offset < 0xf0) {
      this.clockIn();
      const byte = this.received.shift() ?? 0;
      if (this.received.length === 0) this.chip.deselect();
      return byte;
    }
    return this.words.get(offset) ?? 0;
  }
  writeUint32(offset, v) {
    if (offset >= 0x60 && offset < 0xf0) {
      const byte = this.chip.exchange(v & 0xff);
      if (this.mode === EEPROM_READ) this.toRead = (this.words.get(4) ?? 0) + 1;
      else if (this.mode === 0) this.received.push(byte);
      return;
    }
    if (offset === 8) {
      // disabling flushes the FIFOs and releases the chip
      this.received = [];
      this.toRead = 0;
      this.chip.deselect();
    }
    this.words.set(offset, v);
  }
}
