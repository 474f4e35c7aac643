//! Renders the lines from the slots.
//!
//! [`Controller::render`] looks at a line only when it changes: the loop over all lines takes most of the chip's time.

use crate::controller::pool::Kind;
use crate::controller::{Controller, NEVER, Run};
use crate::message::{Report, Trigger};
use crate::stroke::{Line, Stroke};
use crate::tick::Tick;

/// The trigger output: the cells of a pulse or a code, one after the other.
#[derive(Debug)]
pub(super) struct TriggerOutput {
    /// Bit 0 is the present cell, bit 1 the next one.
    cells: u16,
    /// Ticks of a cell.
    width: u16,
    /// The end of the present cell.
    cell_end: Tick,
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
    /// Renders the lines from the rendered end on, for `max` ticks or until a line changes.
    pub fn render(&mut self, max: u32) -> Run {
        if max == 0 {
            // Do not bring lines to a tick that is not rendered: it can still be amended.
            return Run { lines: self.lines, trigger: false, ticks: 0 };
        }
        let (trigger, mut change) = self.trigger();
        if self.next_change <= self.rendered {
            let now = self.rendered.0 as u32;
            let (mut due, mut nearest) = (0u32, i32::MAX);
            for (motor, change) in self.changes.iter().enumerate() {
                let ahead = change.wrapping_sub(now).cast_signed();
                if self.waiting >> motor & 1 == 0 {
                    continue;
                }
                if ahead <= 0 {
                    due |= 1 << motor;
                } else if ahead < nearest {
                    nearest = ahead;
                }
            }
            let mut motor = 0;
            while due >> motor != 0 {
                if due >> motor & 1 == 1
                    && let Some(until) = self.step(motor)
                {
                    nearest = nearest.min((until - self.rendered) as i32);
                }
                motor += 1;
            }
            let none = self.waiting == 0;
            self.next_change = if none { NEVER } else { self.rendered + u64::from(nearest.cast_unsigned()) };
        }
        change = change.min(self.next_change);
        let ticks = (change - self.rendered).min(max.into());
        self.rendered = self.rendered + ticks;
        Run { lines: self.lines, trigger, ticks: ticks as u32 }
    }

    /// Whether the trigger is high at the rendered end, and the tick until which it stays so.
    fn trigger(&mut self) -> (bool, Tick) {
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

    /// Has the line of `motor` looked at no later than when `tick` is rendered.
    pub(super) fn change_by(&mut self, motor: usize, tick: Tick) {
        let bit = 1 << motor;
        let low = tick.0 as u32;
        if self.waiting & bit == 0 || self.changes[motor].wrapping_sub(low).cast_signed() > 0 {
            self.changes[motor] = low;
        }
        self.waiting |= bit;
        self.next_change = self.next_change.min(tick);
    }

    /// Sets one line to what its slots give for the rendered end. Returns when it changes next.
    fn step(&mut self, motor: usize) -> Option<Tick> {
        let now = self.rendered;
        let (line, until) = loop {
            let index = self.pool.queues[motor].cursor;
            let Some(slot) = self.pool.get_mut(index) else { break (Line::Off, NEVER) };
            let stroke = slot.stroke;
            if slot.kind == Kind::Play && slot.charged.is_none() && stroke.up <= now {
                let surplus = slot.surplus().into();
                let begun = self.on_time.begin(now, motor, stroke.pulses()).and_then(|()| {
                    self.pushing.begin(now, motor, surplus).inspect_err(|_| {
                        self.on_time.end(now, motor, stroke.pulses(), 0);
                    })
                });
                match begun {
                    Ok(()) => slot.charged = Some(stroke.pulses()),
                    Err(reason) => {
                        slot.kind = Kind::Void;
                        slot.stroke = Stroke { up_pulses: 0, down: stroke.up, down_pulses: 0, ..stroke };
                        self.next_end = self.next_end.min(stroke.up);
                        self.counters.refused += 2;
                        self.report(Report::Refused { motor: motor as u8, up: stroke.up.wire(), reason });
                        continue;
                    }
                }
            }
            if let Some(present) = slot.at(now) {
                break present;
            }
            if let Some(charged) = slot.charged.take() {
                self.on_time.end(now, motor, charged, stroke.pulses());
                self.pushing.end(now, motor, slot.surplus().into(), slot.surplus().into());
            }
            self.pool.advance(motor);
        };
        let bit = 1 << motor;
        self.lines.up &= !bit;
        self.lines.down &= !bit;
        if let Line::Pulse(direction) = line {
            *self.lines.mask_mut(direction) |= bit;
        }
        self.changes[motor] = until.0 as u32;
        if until == NEVER {
            self.waiting &= !bit;
            return None;
        }
        Some(until)
    }
}
