// The other end of the cable: a full-speed host that enumerates, opens a CDC-ACM port and a vendor interface's bulk pair.
// One transaction at a time, each as long as its bytes take on the bus. A NAKed endpoint is asked again as soon as the device
// has armed it (a real host polls; the mean wait is `POLL_NS`). Not modelled: hubs, bus errors, bit stuffing, other devices.
// CDC IN is polled only while DTR is up, as with an open tty.

const NANOS_PER_BYTE = 8e3 / 12;
/** Sync, PIDs, token, CRCs, handshake and turn-around of a bulk transaction. */
const OVERHEAD_BYTES = 13;
const POLL_NS = 3e3;
const MS = 1e6;
// Linux debounces for 100 ms; the firmware sees no difference, so the bench leaves it out
const DEBOUNCE_NS = 5 * MS;
const RESET_NS = 10 * MS;
const SUSPEND_NS = 3 * MS;
const RESUME_NS = 20 * MS;
const SETTLE_NS = 0.2 * MS;

const request = (type, code, value, index, length) =>
  Uint8Array.of(type, code, value & 255, value >> 8, index & 255, index >> 8, length & 255, length >> 8);

/** Bytes to send: packets never span two writes, as with one URB per write. */
class Outbox {
  constructor() {
    this.sends = [];
    this.queued = 0;
  }
  push(bytes) {
    if (!bytes.length) return;
    this.sends.push(bytes);
    this.queued += bytes.length;
  }
  peek(most) {
    return this.sends[0].subarray(0, most);
  }
  drop(n) {
    this.queued -= n;
    if (n === this.sends[0].length) this.sends.shift();
    else this.sends[0] = this.sends[0].subarray(n);
  }
  clear() {
    this.sends = [];
    this.queued = 0;
  }
}

export class UsbHost {
  constructor(clock) {
    this.clock = clock;
    this.device = null;
    this.plugged = true;
    this.wantsDtr = false;
    this.out = { cdc: new Outbox(), bulk: new Outbox() };
    this.onIn = () => {}; // (pipe, bytes)
    this.onOut = () => {}; // (pipe, bytes): a data packet has been accepted
    this.onSetup = () => {}; // (): the device has taken the SETUP packet of a request from `control`
    this.onControl = () => {}; // (): a transaction of a control transfer begins or has ended
    this.onCable = () => {}; // (): plugged in or out
    this.onConfigured = () => {};
    this.toggleErrors = 0;
    this.configured = false;
    this.createAlarms();
    this.forget();
  }
  createAlarms() {
    this.bus = this.clock.createAlarm(() => this.complete());
    this.stage = this.clock.createAlarm(() => this.then());
    this.sof = this.clock.createAlarm(() => this.frame());
    this.quiet = this.clock.createAlarm(() => this.device?.suspend());
  }
  /** Called after a chip reset, which has emptied the clock's queue and made a new controller. */
  connect(device) {
    this.createAlarms();
    this.device = device;
    device.host = this;
    this.forget();
  }
  /** The device is gone, with the bytes under way to it and an open tty. Requests made before attachment wait. */
  forget() {
    if (this.configured) {
      this.out.cdc.clear();
      this.out.bulk.clear();
      this.wantsDtr = false;
    }
    this.state = 'detached'; // detached, reset, enumerating, configured, suspended, hung
    this.configured = false;
    this.address = 0;
    this.pipes = {}; // name → { ep, out, size, data1 }
    this.dtr = false;
    this.control = null;
    this.controls = [];
    this.current = null;
    this.frameNumber = 0;
    this.turn = 0;
    for (const a of [this.bus, this.stage, this.sof, this.quiet]) a.cancel();
  }
  after(nanos, then) {
    this.then = then;
    this.stage.schedule(nanos);
  }

  // ---- the cable

  attachmentChanged() {
    const here = this.plugged && this.device.attached;
    if (here && this.state === 'detached') this.after(DEBOUNCE_NS, () => this.reset());
    else if (!here && this.state !== 'detached') this.forget();
    else if (!here) this.stage.cancel();
  }
  /** The device's controller answers nothing any more, and sees nothing, until it is reset: what RP2040-E15 is like. */
  hang() {
    if (this.state !== 'configured') return;
    this.state = 'hung';
    for (const a of [this.bus, this.stage, this.sof, this.quiet]) a.cancel();
    this.current = null;
  }
  unplug() {
    if (!this.plugged) return;
    this.plugged = false;
    this.onCable();
    this.out.cdc.clear();
    this.out.bulk.clear();
    const bus = this.state !== 'detached';
    this.forget();
    if (bus) this.quiet.schedule(SUSPEND_NS);
  }
  plug() {
    if (this.plugged) return;
    this.plugged = true;
    this.onCable();
    this.quiet.cancel();
    this.attachmentChanged();
  }
  /** Resets the bus, whatever is under way, and enumerates the device again. */
  resetBus() {
    if (['detached', 'hung'].includes(this.state)) return;
    this.forget();
    this.reset();
  }
  /** Gives up the control transfer under way, as a host does whose program cancels it. The next one begins at once. */
  abandon() {
    if (!this.control || !this.configured) return;
    this.bus.cancel();
    this.current = this.control = null;
    this.nextControl();
  }
  suspend() {
    if (this.state !== 'configured') return;
    this.state = 'suspended';
    this.sof.cancel();
    this.bus.cancel();
    this.current = null;
    this.quiet.schedule(SUSPEND_NS);
  }
  resume() {
    if (this.state !== 'suspended') return;
    this.quiet.cancel();
    this.device.resume();
    this.after(RESUME_NS, () => {
      this.state = 'configured';
      this.frame();
      this.nextControl();
    });
  }
  reset() {
    this.state = 'reset';
    this.device.busReset();
    this.after(RESET_NS, () => {
      this.state = 'enumerating';
      this.frame();
      this.after(RESET_NS, () => this.enumerate());
    });
  }
  frame() {
    this.frameNumber = (this.frameNumber + 1) & 0x7ff;
    this.sof.schedule(MS);
    this.device.startOfFrame(this.frameNumber);
  }

  // ---- requests

  /** Queues a control request; `done` gets the bytes of the data stage, or null after a STALL. */
  ask(setup, { data = null, done = () => {} } = {}) {
    this.controls.push({ setup, data, done, phase: 'setup', got: [], sent: 0, length: setup[6] | (setup[7] << 8), data1: true });
    this.nextControl();
  }
  /** A program's control transfer; `done` as for `ask`. */
  transfer(setup, data, done) {
    if (!this.configured) throw new Error('transfer: the device is not configured');
    this.ask(setup, { data, done });
  }
  /** A program's control request without data, from its SETUP packet. A device that is not configured gets none. */
  program(setup) {
    if (!this.configured) return;
    this.controls.push({ setup, data: null, done: () => {}, phase: 'setup', got: [], sent: 0, length: 0, data1: true, own: true });
    this.nextControl();
  }
  nextControl() {
    this.control ??= this.controls.shift() ?? null;
    this.pump();
  }
  finishControl(result) {
    const { done } = this.control;
    this.control = null;
    done(result);
    // a driver takes some time between requests
    if (!this.stage.scheduled) this.after(SETTLE_NS, () => this.nextControl());
  }
  enumerate() {
    const get = (type, length, done, index = 0, language = 0) => this.ask(request(0x80, 6, (type << 8) | index, language, length), { done });
    this.ask(request(0, 5, 1, 0, 0), {
      done: () => {
        this.address = 1;
      },
    });
    get(1, 18, (d) => {
      this.serialIndex = d?.[16] ?? 0;
    });
    get(2, 9, (head) => {
      const total = head[2] | (head[3] << 8);
      get(2, total, (d) => {
        this.parse(d);
        if (this.serialIndex) get(3, 255, () => {}, this.serialIndex, 0x409);
        this.ask(request(0, 9, d[5], 0, 0), {
          done: () => {
            if (this.pipes.cdc) this.ask(request(0x21, 0x20, 0, this.cdcInterface, 7), { data: Uint8Array.of(0, 0xc2, 1, 0, 0, 0, 8) });
            this.ask(request(0x80, 0, 0, 0, 2), { done: () => this.enumerated() });
          },
        });
      });
    });
  }
  enumerated() {
    this.state = 'configured';
    this.configured = true;
    if (this.wantsDtr) this.setDtr(true);
    this.onConfigured();
    this.pump();
  }
  setDtr(up) {
    this.wantsDtr = up;
    if (!this.configured || !this.pipes.cdc) return;
    this.ask(request(0x21, 0x22, up ? 3 : 0, this.cdcInterface, 0), {
      done: () => {
        this.dtr = up;
        this.pump();
      },
    });
  }
  parse(d) {
    let kind = null;
    for (let i = 0; i < d.length && d[i] > 0; i += d[i]) {
      if (d[i + 1] === 4) {
        kind = { 2: 'notify', 10: 'cdc', 255: 'bulk' }[d[i + 5]] ?? null;
        if (kind === 'notify') this.cdcInterface = d[i + 2];
      }
      if (d[i + 1] !== 5 || !kind) continue;
      const out = !(d[i + 2] & 0x80);
      const pipe = { name: kind, ep: d[i + 2] & 15, out, size: d[i + 4] | (d[i + 5] << 8), data1: false };
      if (out) this.pipes[`${kind}Out`] = pipe;
      else this.pipes[kind] = pipe;
    }
  }

  // ---- transactions

  send(pipe, bytes) {
    this.out[pipe].push(bytes);
    this.pump();
  }
  armed() {
    this.pump();
  }
  /** Starts the next transaction that the device accepts, if the bus is free. */
  pump() {
    // No device has this address: the host waits, instead of giving up after some tries.
    if (this.device && this.device.address !== this.address) return;
    if (this.current || !this.plugged || ['detached', 'reset', 'suspended', 'hung'].includes(this.state)) return;
    const next = this.nextOnControl() ?? this.nextOnPipes();
    if (!next) return;
    this.current = next;
    this.bus.schedule(POLL_NS + (OVERHEAD_BYTES + next.bytes) * NANOS_PER_BYTE);
    if (next.control) this.onControl();
  }
  nextOnControl() {
    const c = this.control;
    if (!c) return null;
    const control = true;
    if (c.phase === 'setup') return { control, bytes: 8, complete: () => this.setupDone(c) };
    const out = c.phase === 'out' || c.phase === 'statusOut';
    const state = this.device.state(0, out);
    if (state === 'stall') return { control, bytes: 0, complete: () => this.device.state(0, out) === 'stall' && this.finishControl(null) };
    if (state === 'nak') return null;
    return { control, bytes: out ? 0 : this.device.length(0, false), complete: () => this.controlPacket(c, out) };
  }
  setupDone(c) {
    this.device.setup(c.setup);
    if (c.own) this.onSetup();
    c.phase = c.data ? 'out' : c.length ? 'in' : 'statusIn';
  }
  controlPacket(c, out) {
    if (this.device.state(0, out) !== 'ready') return; // the device has withdrawn the buffer meanwhile
    if (c.phase === 'in') {
      const { bytes } = this.device.takeIn(0);
      c.got.push(...bytes);
      if (c.got.length >= c.length || bytes.length < 64) c.phase = 'statusOut';
    } else if (c.phase === 'out') {
      this.device.giveOut(0, c.data.subarray(c.sent, c.sent + 64), c.data1);
      c.sent += 64;
      c.data1 = !c.data1;
      if (c.sent >= c.data.length) c.phase = 'statusIn';
    } else {
      if (out) this.device.giveOut(0, new Uint8Array(0), true);
      else this.device.takeIn(0);
      this.finishControl(c.got);
    }
  }
  nextOnPipes() {
    if (!this.configured) return null;
    const { cdc, cdcOut, bulk, bulkOut, notify } = this.pipes;
    const order = [cdcOut, bulkOut, cdc, bulk, notify];
    // round robin, so that no pipe starves another
    for (let i = 0; i < order.length; i++) {
      const which = (this.turn + i) % order.length;
      const pipe = order[which];
      if (!pipe || (pipe === cdc && !this.dtr) || (pipe.out && !this.out[pipe.name].queued)) continue;
      if (this.device.state(pipe.ep, pipe.out) !== 'ready') continue;
      this.turn = which + 1;
      const bytes = pipe.out ? this.out[pipe.name].peek(pipe.size).length : this.device.length(pipe.ep, false);
      return { bytes, complete: () => (pipe.out ? this.outPacket(pipe) : this.inPacket(pipe)) };
    }
    return null;
  }
  outPacket(pipe) {
    if (this.device.state(pipe.ep, true) !== 'ready') return; // the device has withdrawn the buffer meanwhile
    const bytes = this.out[pipe.name].peek(pipe.size);
    if (!this.device.giveOut(pipe.ep, bytes, pipe.data1)) this.toggleErrors++;
    this.out[pipe.name].drop(bytes.length);
    pipe.data1 = !pipe.data1;
    this.onOut(pipe.name, bytes.length);
  }
  inPacket(pipe) {
    if (this.device.state(pipe.ep, false) !== 'ready') return;
    const { bytes, data1 } = this.device.takeIn(pipe.ep);
    if (data1 !== pipe.data1) {
      this.toggleErrors++; // the host takes it for a repeated packet
      return;
    }
    pipe.data1 = !pipe.data1;
    if (bytes.length && pipe.name !== 'notify') this.onIn(pipe.name, bytes);
  }
  complete() {
    const { current } = this;
    this.current = null;
    current.complete();
    if (current.control) this.onControl();
    this.pump();
  }
}
