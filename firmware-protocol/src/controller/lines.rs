//! Renders the lines from the slots.
//!
//! [`Controller::render`] looks at a line only when it changes: the loop over all lines takes most of the chip's time.

use crate::controller::pool::Kind;
use crate::controller::{Controller, NEVER, Run, TRIGGER_TICKS};
use crate::message::Report;
use crate::stroke::{Line, Stroke};
use crate::tick::Tick;

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
        if self.onsets.iter().any(|&mark| mark == now) {
            self.trigger_from(now);
        }
        for &mark in self.onsets.iter().filter(|&&mark| mark > now) {
            next = next.min(mark);
        }
        if now < self.triggered { (true, next.min(self.triggered)) } else { (false, next) }
    }

    pub(super) fn trigger_from(&mut self, onset: Tick) {
        self.triggered = onset + u64::from(TRIGGER_TICKS);
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
                match self.on_time.begin(now, motor, stroke.pulses()) {
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
