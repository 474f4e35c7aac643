//! Renders the lines from the slots.
//!
//! [`Controller::render`] looks at a line only when it changes, and computes in 32 bits where it can: it takes most of the chip's time.

use crate::controller::pool::{Kind, charge};
use crate::controller::{BLOCK, Controller, NEVER, Run};
use crate::message::{Report, Trigger};
use crate::stroke::{Line, Stroke};
use crate::tick::Tick;

/// The lines that may change in the next ticks, tick by tick, so that rendering a block looks at all lines only once. Ticks are
/// low halves.
#[derive(Clone, Debug, Hash)]
pub(super) struct Window {
    /// The first tick.
    begin: u32,
    /// The lines that may change in each tick.
    lines: [u32; BLOCK as usize],
    /// Bit i: lines may change in tick i.
    some: u32,
}

impl Window {
    /// A window that has to be opened before the next tick is rendered.
    pub(super) const CLOSED: Self = Self { begin: 0, lines: [0; BLOCK as usize], some: 0 };

    /// A window that ends at `now`.
    pub(super) const fn before(now: Tick) -> Self {
        Self { begin: (now.0 as u32).wrapping_sub(BLOCK), ..Self::CLOSED }
    }

    /// Notes that the line of `bit` changes at `tick`, if the window includes that tick.
    fn add(&mut self, bit: u32, tick: u32) {
        let at = tick.wrapping_sub(self.begin);
        if let Some(lines) = self.lines.get_mut(at as usize) {
            *lines |= bit;
            self.some |= 1 << at;
        }
    }

    /// Removes the lines of the tick `now`.
    fn take(&mut self, now: u32) -> u32 {
        let at = now.wrapping_sub(self.begin);
        self.some &= !(1 << (at % BLOCK));
        self.lines.get_mut(at as usize).map_or(0, core::mem::take)
    }

    /// Ticks from `now` in which no line changes, at least 1, within the window.
    fn quiet(&self, now: u32) -> u32 {
        let at = now.wrapping_sub(self.begin) % BLOCK;
        let (mut ticks, mut later) = (1, self.some >> at >> 1);
        while later & 1 == 0 && at + ticks < BLOCK {
            later >>= 1;
            ticks += 1;
        }
        ticks
    }
}

/// The trigger output: the cells of a pulse or a code, one after the other.
#[derive(Clone, Debug)]
pub(super) struct TriggerOutput {
    /// Bit 0 is the present cell, bit 1 the next one.
    pub(super) cells: u16,
    /// Ticks of a cell.
    pub(super) width: u16,
    /// The end of the present cell.
    pub(super) cell_end: Tick,
}

impl TriggerOutput {
    /// An output that is low.
    pub(super) const LOW: Self = Self { cells: 0, width: 1, cell_end: Tick(0) };

    /// Begins at `now`; ends what is on its way.
    pub(super) fn begin(&mut self, now: Tick, trigger: Trigger) {
        // The start cell, then the code's bits. A code has no high cell after them.
        self.cells = 1 | u16::from(trigger.code) << 1;
        self.width = trigger.width.max(1);
        self.cell_end = now + u64::from(self.width);
    }

    /// Whether it is high at `now`, and the tick until which its cell lasts.
    fn level(&mut self, now: Tick) -> (bool, Tick) {
        while self.cells != 0 && self.cell_end <= now {
            self.cells >>= 1;
            self.cell_end = self.cell_end + u64::from(self.width);
        }
        if self.cells == 0 { (false, NEVER) } else { (self.cells & 1 == 1, self.cell_end) }
    }
}

impl Controller {
    /// Renders the outputs from the rendered end on, for `max` ticks or until one changes.
    pub fn render(&mut self, max: u32) -> Run {
        if max == 0 {
            // Do not bring lines to a tick that is not rendered: it can still be amended.
            return Run { lines: self.lines, trigger: false, drivers: false, ticks: 0 };
        }
        let (trigger, change) = self.trigger();
        let now = self.rendered.0 as u32;
        if now.wrapping_sub(self.window.begin) >= BLOCK {
            self.open_window(now);
        }
        let mut due = self.window.take(now);
        let mut motor = 0;
        while due != 0 {
            // The chip's core has no instruction that finds the next bit.
            if due & 0xff == 0 {
                due >>= 8;
                motor += 8;
                continue;
            }
            if due & 1 == 1 {
                self.step(motor);
            }
            due >>= 1;
            motor += 1;
        }
        let ticks = self.window.quiet(now).min(max);
        let ticks = (change - self.rendered).min(ticks.into());
        let (drivers, ticks) = self.enable_drivers(ticks);
        self.rendered = self.rendered + ticks;
        Run { lines: self.lines, trigger, drivers, ticks: ticks as u32 }
    }

    /// Moves the window to the rendered end.
    #[inline(never)]
    fn open_window(&mut self, now: u32) {
        self.window = Window { begin: now, ..Window::CLOSED };
        self.density.next_block();
        let (mut waiting, mut bit) = (self.waiting, 1);
        for change in &self.changes {
            if waiting & 1 == 1 {
                // A change that is overdue happens now.
                let ahead = change.wrapping_sub(now).cast_signed().max(0).cast_unsigned();
                self.window.add(bit, now.wrapping_add(ahead));
            }
            waiting >>= 1;
            bit <<= 1;
        }
    }

    /// Whether the trigger is high at the rendered end, and the tick until which it stays so.
    fn trigger(&mut self) -> (bool, Tick) {
        if self.marks.is_empty() && self.trigger_output.cells == 0 {
            return (false, NEVER);
        }
        let now = self.rendered;
        let mut next = NEVER;
        for &(mark, trigger) in &self.marks {
            if mark > now {
                next = next.min(mark);
            } else if mark == now
                && let Some(trigger) = trigger
            {
                self.trigger_output.begin(now, trigger);
            }
        }
        let (high, until) = self.trigger_output.level(now);
        (high, next.min(until))
    }

    /// Makes rendering look at the line of `motor` at `tick` or before.
    pub(super) fn change_by(&mut self, motor: usize, tick: Tick) {
        let bit = 1 << motor;
        let low = tick.max(self.rendered).0 as u32;
        if self.waiting & bit == 0 || self.changes[motor].wrapping_sub(low).cast_signed() > 0 {
            self.changes[motor] = low;
        }
        self.waiting |= bit;
        self.window.add(bit, low);
    }

    /// Sets one line to what its slots give for the rendered end.
    #[inline(never)]
    fn step(&mut self, motor: usize) {
        let now = self.rendered;
        let present = loop {
            let index = self.pool.queues[motor].cursor;
            let Some(slot) = self.pool.get_mut(index) else { break None };
            if slot.kind == Kind::Play && slot.charged.is_none() && slot.stroke.up <= now {
                let (stroke, pushes) = (slot.stroke, slot.pushes);
                let pulses = stroke.pulses();
                let begun = self.density.begin().and_then(|()| self.check_at_once(&stroke));
                let begun = begun.and_then(|()| self.on_time.begin(now, motor, pulses)).and_then(|()| {
                    self.pushing.begin(now, motor, pushes.into()).inspect_err(|_| {
                        self.on_time.end(now, motor, pulses, 0);
                    })
                });
                let Some(slot) = self.pool.get_mut(index) else { break None };
                match begun {
                    Ok(()) => slot.charged = Some(charge(&slot.stroke)),
                    Err(reason) => {
                        let up = slot.stroke.up;
                        slot.kind = Kind::Void;
                        slot.stroke = Stroke { up_pulses: 0, down: up, down_pulses: 0, ..slot.stroke };
                        self.next_end = self.next_end.min(up);
                        self.counters.refused += 2;
                        self.report(Report::Refused { motor: motor as u8, up: up.wire(), reason });
                        continue;
                    }
                }
            }
            let Some(slot) = self.pool.get_mut(index) else { break None };
            if let Some(present) = slot.at(now) {
                break Some(present);
            }
            if let Some(charged) = slot.charged.take() {
                self.on_time.end(now, motor, charged.into(), slot.stroke.pulses());
                self.pushing.end(now, motor, slot.pushes.into(), slot.pushes.into());
            }
            self.pool.advance(motor);
        };
        let bit = 1 << motor;
        self.lines.up &= !bit;
        self.lines.down &= !bit;
        let Some((line, ticks)) = present else {
            self.waiting &= !bit;
            return;
        };
        if let Line::Pulse(direction) = line {
            *self.lines.mask_mut(direction) |= bit;
        }
        let change = (now.0 as u32).wrapping_add(ticks);
        self.changes[motor] = change;
        self.window.add(bit, change);
    }
}
