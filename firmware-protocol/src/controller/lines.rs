//! Rendering: what the lines do next, from the slots.

use crate::controller::pool::Kind;
use crate::controller::reports::RESERVE;
use crate::controller::{Controller, NEVER, Run, TRIGGER_TICKS};
use crate::message::Report;
use crate::stroke::{Line, MOTORS, Stroke};
use crate::tick::Tick;

impl Controller {
    /// The lines from the rendered end on, for `max` ticks or until a line changes.
    pub fn render(&mut self, max: u32) -> Run {
        if max == 0 {
            // A line is brought to a tick only together with rendering it: until then the tick can be amended.
            return Run { lines: self.lines, trigger: false, ticks: 0 };
        }
        let (trigger, mut change) = self.trigger();
        for motor in 0..MOTORS {
            if self.changes[motor] <= self.rendered {
                self.step(motor);
            }
            change = change.min(self.changes[motor]);
        }
        let ticks = (change - self.rendered).min(max.into());
        self.rendered = self.rendered + ticks;
        Run { lines: self.lines, trigger, ticks: ticks as u32 }
    }

    /// Whether the trigger is high at the rendered end, and until when that holds.
    fn trigger(&mut self) -> (bool, Tick) {
        let now = self.rendered;
        let mut next = NEVER;
        if self.marks.iter().any(|&mark| mark == now) {
            self.trigger_from(now);
        }
        for &mark in self.marks.iter().filter(|&&mark| mark > now) {
            next = next.min(mark);
        }
        if now < self.triggered { (true, next.min(self.triggered)) } else { (false, next) }
    }

    pub(super) fn trigger_from(&mut self, onset: Tick) {
        self.triggered = onset + u64::from(TRIGGER_TICKS);
    }

    /// Brings one line to the rendered end: what its slots say about that tick.
    fn step(&mut self, motor: usize) {
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
                        self.counters.refused += 2;
                        if self.reports.free() > RESERVE {
                            self.report(Report::Refused { motor: motor as u8, up: stroke.up.wire(), reason });
                        } else {
                            self.counters.reports_lost += 1;
                        }
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
        self.changes[motor] = until;
    }
}
