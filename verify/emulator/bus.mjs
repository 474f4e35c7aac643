// Memory accesses of the core and the DMA: SRAM and flash directly, everything else through rp2040js's address map.
// An unaligned word or an unmapped address is a fault, as on the chip (rp2040js only warns).

/** A failed access or an undefined instruction: the core raises a HardFault, the DMA stops its channel. */
export class Fault extends Error {}

const SRAM_BYTES = 264 * 1024;
const ROM_BYTES = 16 * 1024;

export class Bus {
  constructor(mcu) {
    this.mcu = mcu;
    this.ppb = null;
    this.rom = new Int32Array(mcu.bootrom.buffer);
    this.rom16 = new Uint16Array(mcu.bootrom.buffer);
    this.sram32 = new Int32Array(mcu.sram.buffer);
    this.sram16 = new Uint16Array(mcu.sram.buffer);
    this.sram8 = mcu.sram;
    this.flash32 = new Int32Array(mcu.flash.buffer);
    this.flash16 = new Uint16Array(mcu.flash.buffer);
    this.flash8 = mcu.flash;
  }
  fetch(a) {
    if (a >>> 24 === 0x10) return this.flash16[(a & 0xffffff) >> 1];
    if (a >>> 24 === 0x20 && (a & 0xffffff) < SRAM_BYTES) return this.sram16[(a & 0xffffff) >> 1];
    if (a >>> 0 < ROM_BYTES) return this.rom16[a >> 1];
    throw new Fault(`no instruction at ${(a >>> 0).toString(16)}`);
  }
  read32(a) {
    if (a & 3) throw new Fault(`unaligned read ${(a >>> 0).toString(16)}`);
    const low = a & 0xffffff;
    if (a >>> 24 === 0x20 && low < SRAM_BYTES) return this.sram32[low >> 2];
    if (a >>> 24 === 0x10) return this.flash32[low >> 2];
    return this.readSlow(a);
  }
  read16(a) {
    if (a & 1) throw new Fault(`unaligned read ${(a >>> 0).toString(16)}`);
    const low = a & 0xffffff;
    if (a >>> 24 === 0x20 && low < SRAM_BYTES) return this.sram16[low >> 1];
    if (a >>> 24 === 0x10) return this.flash16[low >> 1];
    return (this.readSlow(a & ~3) >>> (8 * (a & 2))) & 0xffff;
  }
  read8(a) {
    const low = a & 0xffffff;
    if (a >>> 24 === 0x20 && low < SRAM_BYTES) return this.sram8[low];
    if (a >>> 24 === 0x10) return this.flash8[low];
    return (this.readSlow(a & ~3) >>> (8 * (a & 3))) & 0xff;
  }
  write32(a, v) {
    if (a & 3) throw new Fault(`unaligned write ${(a >>> 0).toString(16)}`);
    const low = a & 0xffffff;
    if (a >>> 24 === 0x20 && low < SRAM_BYTES) this.sram32[low >> 2] = v;
    else this.writeSlow(a, v);
  }
  write16(a, v) {
    if (a & 1) throw new Fault(`unaligned write ${(a >>> 0).toString(16)}`);
    const low = a & 0xffffff;
    if (a >>> 24 === 0x20 && low < SRAM_BYTES) this.sram16[low >> 1] = v;
    else this.writeNarrow(a, v & 0xffff, 2);
  }
  write8(a, v) {
    const low = a & 0xffffff;
    if (a >>> 24 === 0x20 && low < SRAM_BYTES) this.sram8[low] = v;
    else this.writeNarrow(a, v & 0xff, 1);
  }

  readSlow(address) {
    const a = address >>> 0;
    const { mcu } = this;
    if (a < ROM_BYTES) return this.rom[a >> 2];
    if (a >>> 24 > 0x10 && a >>> 24 <= 0x13) return this.flash32[(a & 0xffffff) >> 2]; // the uncached aliases
    if (a >>> 12 === 0xe000e) return this.ppb.readUint32(a & 0xfff);
    if (a >>> 12 === 0x50100) return mcu.usbDPRAMView.getInt32(a & 0xfff, true);
    if (a >>> 28 === 0xd) return mcu.sio.readUint32(a & 0xfff);
    const peripheral = mcu.findPeripheral(a);
    if (peripheral === undefined) throw new Fault(`no register to read at ${a.toString(16)}`);
    return peripheral.readUint32(a & 0xfff); // the atomic aliases read as the plain register
  }
  writeSlow(address, v) {
    const a = address >>> 0;
    const { mcu } = this;
    if (a >>> 12 === 0xe000e) return this.ppb.writeUint32(a & 0xfff, v >>> 0);
    if (a >>> 28 === 0xd) return mcu.sio.writeUint32(a & 0xfff, v >>> 0);
    if (a >>> 12 === 0x50100) {
      mcu.usbDPRAMView.setInt32(a & 0xfff, v, true);
      mcu.usbCtrl.bufferControlWritten(a & 0xfff);
      return;
    }
    const peripheral = mcu.findPeripheral(a);
    if (peripheral === undefined) throw new Fault(`nothing to write at ${a.toString(16)}`);
    peripheral.writeUint32Atomic(a & 0xfff, v >>> 0, (a >> 12) & 3);
  }
  /** Writes bytes and halfwords to memory; a peripheral's register sees them on all byte lanes. */
  writeNarrow(a, v, bytes) {
    if (a >>> 12 === 0x50100) {
      this.mcu.usbDPRAM[a & 0xfff] = v;
      if (bytes === 2) this.mcu.usbDPRAM[(a & 0xfff) + 1] = v >> 8;
      this.mcu.usbCtrl.bufferControlWritten(a & 0xffc);
      return;
    }
    this.writeSlow(a & ~3, bytes === 1 ? v * 0x01010101 : v * 0x00010001);
  }
}
