// Time of the whole emulation in clk_sys cycles, and the queue of future events.
// It replaces rp2040js's nanosecond clock (same createAlarm interface), because the firmware's contract is in cycles
// and sums of 7.843 ns steps drift. It knows no peripherals; the board reports each change of clk_sys to it.

/** Indices of `Clock.t`, a typed array so that the interpreter's hot loop reads it without boxing. */
export const NOW = 0;
export const NEXT = 1;

class Alarm {
  constructor(clock, callback) {
    Object.assign(this, { clock, callback, next: null, cycle: 0, nanos: NaN, scheduled: false });
  }
  /** rp2040js's interface, in nanoseconds: the alarm's cycle changes when clk_sys does. */
  schedule(deltaNanos) {
    this.nanos = this.clock.nanos + deltaNanos;
    this.clock.link(this, this.clock.cycleOf(this.nanos));
  }
  /** In cycles, for parts clocked by clk_sys. */
  scheduleAt(cycle) {
    this.nanos = NaN;
    this.clock.link(this, cycle);
  }
  cancel() {
    if (this.scheduled) this.clock.unlink(this);
  }
}

export class Clock {
  constructor(hz) {
    this.t = new Float64Array([0, Infinity]);
    this.hz = hz;
    this.baseCycle = 0;
    this.baseNanos = 0;
    this.head = null;
  }
  get cycle() {
    return this.t[NOW];
  }
  get nanos() {
    return this.baseNanos + ((this.t[NOW] - this.baseCycle) * 1e9) / this.hz;
  }
  /** First cycle at which `nanos` has been reached; the slack keeps a rounding error from costing a whole cycle. */
  cycleOf(nanos) {
    return Math.max(this.t[NOW], this.baseCycle + Math.ceil(((nanos - this.baseNanos) * this.hz) / 1e9 - 1e-6));
  }
  createAlarm(callback) {
    return new Alarm(this, callback);
  }
  setFrequency(hz) {
    [this.baseNanos, this.baseCycle, this.hz] = [this.nanos, this.t[NOW], hz];
    const all = [];
    for (let a = this.head; a; a = a.next) all.push(a);
    this.clear();
    for (const a of all) this.link(a, Number.isNaN(a.nanos) ? a.cycle : this.cycleOf(a.nanos));
  }
  /** Removes every alarm, as a chip reset does. */
  clear() {
    for (let a = this.head; a; a = a.next) a.scheduled = false;
    this.head = null;
    this.t[NEXT] = Infinity;
  }
  link(alarm, cycle) {
    if (alarm.scheduled) this.unlink(alarm);
    alarm.cycle = cycle;
    alarm.scheduled = true;
    let before = null;
    let at = this.head;
    // alarms of the same cycle fire in the order in which they were set, so that every run is the same
    while (at !== null && at.cycle <= cycle) {
      before = at;
      at = at.next;
    }
    alarm.next = at;
    if (before === null) {
      this.head = alarm;
      this.t[NEXT] = cycle;
    } else before.next = alarm;
  }
  unlink(alarm) {
    alarm.scheduled = false;
    if (this.head === alarm) {
      this.head = alarm.next;
      this.t[NEXT] = this.head === null ? Infinity : this.head.cycle;
      return;
    }
    for (let at = this.head; at !== null; at = at.next) {
      if (at.next === alarm) {
        at.next = alarm.next;
        return;
      }
    }
  }
  /** Runs the events that are due. Each callback sees the clock at its own cycle, even if the current instruction ends later. */
  runDue() {
    const { t } = this;
    const reached = t[NOW];
    while (this.head !== null && this.head.cycle <= reached) {
      const alarm = this.head;
      this.unlink(alarm);
      t[NOW] = alarm.cycle;
      alarm.callback();
    }
    t[NOW] = reached;
  }
}
