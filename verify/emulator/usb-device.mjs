// The RP2040's USB controller in device mode, as the firmware sees it: DPRAM buffer control, SIE status, interrupts.
// rp2040js clears AVAILABLE as soon as the firmware sets it, and has no NAK, STALL, suspend or start of frame. Here a buffer
// stays AVAILABLE until its transaction is over. The host (usb-host.mjs) decides when transactions happen.
// Not modelled: host mode, isochronous endpoints, remote wake-up, bus errors.

import { BasePeripheral } from 'rp2040js';

const IRQ = 5;
const AVAILABLE = 1 << 10;
const STALL = 1 << 11;
const RESET_SELECT = 1 << 12;
const DATA1 = 1 << 13;
const FULL = 1 << 15;
const LENGTH = 0x3ff;
const ENABLE = 1 << 31;
const DOUBLE = 1 << 30;
const INT_PER_BUFFER = 1 << 29;
const INT_PER_TWO = 1 << 28;

/** SIE_STATUS bits, and the interrupt that each raises and, when written back, clears. */
const SIE = { VBUS: 1, SUSPENDED: 1 << 4, RESUME: 1 << 11, CONNECTED: 1 << 16, SETUP: 1 << 17, TRANS: 1 << 18, RESET: 1 << 19, SEQUENCE: 1 << 31 };
const INTERRUPT = new Map([
  [SIE.VBUS, 1 << 11],
  [SIE.SUSPENDED, 1 << 14],
  [SIE.RESUME, 1 << 15],
  [SIE.CONNECTED, 1 << 13],
  [SIE.SETUP, 1 << 16],
  [SIE.TRANS, 1 << 3],
  [SIE.RESET, 1 << 12],
  [SIE.SEQUENCE, 1 << 5],
]);
const BUFF_STATUS = 1 << 4;
const DEV_SOF = 1 << 17;
const LINE_J = 1 << 2;

export class UsbDevice extends BasePeripheral {
  constructor(rp2040) {
    super(rp2040, 'USB');
    /** Set by the board: called at attachment, and for every buffer that becomes available. */
    this.host = null;
    this.reset();
  }
  reset() {
    Object.assign(this, { address: 0, mainCtrl: 0, sieCtrl: 0, sie: 0, raw: 0, enable: 0, force: 0, buffers: 0, stallArm: 0, frame: 0 });
    this.other = new Map();
    this.second = new Uint8Array(32); // which of a pair of buffers is next, by endpoint and direction
    this.rp2040.usbDPRAM.fill(0);
    this.wasAttached = false;
    this.host?.attachmentChanged();
    this.update();
  }
  get attached() {
    return !!(this.mainCtrl & 1 && this.sieCtrl & (1 << 16));
  }

  // ---- for the host

  /** What is under way is cut. Address and buffers stay as they are: it is the firmware that must clear them. */
  busReset() {
    this.second.fill(0);
    this.sie = (this.sie & ~SIE.SUSPENDED) | LINE_J;
    this.flag(SIE.RESET | SIE.CONNECTED);
  }
  suspend() {
    this.flag(SIE.SUSPENDED);
  }
  resume() {
    this.sie &= ~SIE.SUSPENDED;
    this.flag(SIE.RESUME);
  }
  startOfFrame(frame) {
    this.frame = frame;
    this.raw |= DEV_SOF;
    if (this.enable & DEV_SOF) this.update();
  }
  /** Buffers of endpoint 0 that the firmware has made available for an earlier request stay so (raspberrypi/pico-feedback#385). */
  setup(bytes) {
    this.rp2040.usbDPRAM.set(bytes);
    this.stallArm = 0;
    this.second[0] = this.second[1] = 0;
    this.flag(SIE.SETUP);
  }
  /** The endpoint's answer now: 'nak', 'stall' or 'ready'. */
  state(ep, out) {
    if ((this.other.get(0x60) ?? 0) & (1 << (2 * ep + (out ? 1 : 0)))) return 'nak'; // EP_ABORT
    const { word, shift } = this.buffer(ep, out);
    const half = word >>> shift;
    if (ep === 0 ? half & STALL && this.stallArm & (out ? 2 : 1) : half & STALL) return 'stall';
    if (ep !== 0 && !(this.control(ep, out) & ENABLE)) return 'nak';
    return half & AVAILABLE && (out || half & FULL) ? 'ready' : 'nak';
  }
  length(ep, out) {
    const { word, shift } = this.buffer(ep, out);
    return (word >>> shift) & LENGTH;
  }
  /** Takes the packet that is ready; `data1` is its PID. */
  takeIn(ep) {
    const { register, word, shift, offset } = this.buffer(ep, false);
    const half = word >>> shift;
    const bytes = this.rp2040.usbDPRAM.slice(offset, offset + (half & LENGTH));
    this.dpram(register, word & ~((AVAILABLE | FULL) << shift));
    this.done(ep, false);
    return { bytes, data1: !!(half & DATA1) };
  }
  /** Gives a packet. Returns false if its PID is not the expected one: the device then acknowledges and drops it. */
  giveOut(ep, bytes, data1) {
    const { register, word, shift, offset } = this.buffer(ep, true);
    if (!!((word >>> shift) & DATA1) !== data1) {
      this.flag(SIE.SEQUENCE);
      return false;
    }
    const n = Math.min(bytes.length, (word >>> shift) & LENGTH);
    this.rp2040.usbDPRAM.set(bytes.subarray(0, n), offset);
    this.dpram(register, (word & ~((AVAILABLE | LENGTH) << shift)) | ((FULL | n) << shift));
    this.done(ep, true);
    return true;
  }

  // ---- buffers

  dpram(offset, v) {
    const view = this.rp2040.usbDPRAMView;
    if (v === undefined) return view.getUint32(offset, true);
    view.setUint32(offset, v, true);
  }
  control(ep, out) {
    return this.dpram(8 * ep + (out ? 4 : 0));
  }
  buffer(ep, out) {
    const register = 0x80 + 8 * ep + (out ? 4 : 0);
    const control = ep === 0 ? 0x100 : this.control(ep, out);
    const double = ep === 0 ? this.sieCtrl & DOUBLE : control & DOUBLE;
    const second = double ? this.second[2 * ep + (out ? 1 : 0)] : 0;
    return { register, word: this.dpram(register), shift: 16 * second, offset: (control & 0xffc0) + 64 * second, double };
  }
  done(ep, out) {
    const i = 2 * ep + (out ? 1 : 0);
    const control = ep === 0 ? this.sieCtrl : this.control(ep, out);
    const wasSecond = this.second[i];
    if (control & DOUBLE) this.second[i] ^= 1;
    if (control & INT_PER_BUFFER || (control & INT_PER_TWO && wasSecond)) this.buffers |= 1 << i;
    this.update();
  }
  /** The bus calls this after every write to the DPRAM. */
  bufferControlWritten(offset) {
    if (offset < 0x80 || offset >= 0x100) return;
    const ep = (offset - 0x80) >> 3;
    const out = (offset & 4) !== 0;
    const word = this.dpram(offset);
    if (word & RESET_SELECT) {
      this.second[2 * ep + (out ? 1 : 0)] = 0;
      this.dpram(offset, word & ~RESET_SELECT);
    }
    if (word & (AVAILABLE | (AVAILABLE << 16) | STALL)) this.host?.armed(ep, out);
  }

  // ---- registers

  flag(bits) {
    this.sie |= bits;
    for (const [bit, interrupt] of INTERRUPT) if (bits & bit) this.raw |= interrupt;
    this.update();
  }
  get interrupts() {
    return this.raw | (this.buffers ? BUFF_STATUS : 0);
  }
  update() {
    this.rp2040.setInterrupt(IRQ, ((this.interrupts & this.enable) | this.force) !== 0);
  }
  readUint32(offset) {
    switch (offset) {
      case 0x00:
        return this.address;
      case 0x40:
        return this.mainCtrl;
      case 0x48:
        this.raw &= ~DEV_SOF;
        this.update();
        return this.frame;
      case 0x4c:
        return this.sieCtrl;
      case 0x50:
        return this.sie;
      case 0x58:
        return this.buffers;
      case 0x64: // EP_ABORT_DONE: at once
        return this.other.get(0x60) ?? 0;
      case 0x68:
        return this.stallArm;
      case 0x8c:
        return this.interrupts;
      case 0x90:
        return this.enable;
      case 0x94:
        return this.force;
      case 0x98:
        return (this.interrupts & this.enable) | this.force;
      default:
        return this.other.get(offset) ?? 0;
    }
  }
  writeUint32(offset, v) {
    switch (offset) {
      case 0x00:
        this.address = v & 0x7f;
        this.host?.armed(0, false);
        break;
      case 0x40:
        this.mainCtrl = v;
        break;
      case 0x4c:
        this.sieCtrl = v;
        break;
      case 0x50: {
        const cleared = this.rawWriteValue;
        for (const [bit, interrupt] of INTERRUPT)
          if (cleared & bit) {
            if (bit !== SIE.VBUS && bit !== SIE.CONNECTED) this.sie &= ~bit;
            this.raw &= ~interrupt;
          }
        break;
      }
      case 0x58:
        this.buffers &= ~this.rawWriteValue;
        break;
      case 0x60:
        this.other.set(offset, v);
        this.host?.armed(0, false);
        break;
      case 0x68:
        this.stallArm = v & 3;
        this.host?.armed(0, false);
        break;
      case 0x78:
        if (v & 4) this.sie = (this.sie & ~SIE.VBUS) | (v & 8 ? SIE.VBUS : 0);
        this.other.set(offset, v);
        break;
      case 0x90:
        this.enable = v & 0xfffff;
        break;
      case 0x94:
        this.force = v & 0xfffff;
        break;
      default:
        this.other.set(offset, v);
    }
    if (this.attached !== this.wasAttached) {
      this.wasAttached = this.attached;
      this.host?.attachmentChanged();
    }
    this.update();
  }
}
