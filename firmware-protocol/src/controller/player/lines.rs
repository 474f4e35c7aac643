//! Renders the lines from the slots.
//!
//! [`Player::render`] looks at a line only when it changes, and computes in 32 bits where it can: it takes most of the chip's time.

use crate::array::MotorSet;
use crate::controller::Run;
use crate::controller::player::Player;
use crate::controller::player::pool::{Kind, charge};
use crate::controller::reporting::Reporting;
use crate::message::Report;
use crate::stroke::{Line, Stroke};
use crate::tick::Tick;

impl Player {
    /// Renders the outputs from the rendered end on, for `max` ticks or until one changes.
    pub(in crate::controller) fn render(&mut self, max: u32, reporting: &mut Reporting) -> Run {
        if max == 0 {
            // Do not bring lines to a tick that is not rendered: it can still be amended.
            return Run { lines: self.lines, trigger: false, drivers: false, ticks: 0 };
        }
        let (trigger, change) = self.marks.level(self.rendered);
        let now = self.rendered.0 as u32;
        if self.changes.is_over(now) {
            self.changes.open(now);
            self.allowance.next_block();
        }
        for (mut due, mut motor) in self.changes.take(now).parts().into_iter().zip((0..).step_by(32)) {
            while due != 0 {
                // The chip's core has no instruction that finds the next bit.
                if due & 0xff == 0 {
                    due >>= 8;
                    motor += 8;
                    continue;
                }
                if due & 1 == 1 {
                    self.step(motor, reporting);
                }
                due >>= 1;
                motor += 1;
            }
        }
        let ticks = self.changes.quiet(now).min(max);
        let ticks = (change - self.rendered).min(ticks.into());
        let (drivers, ticks) = self.enable_drivers(ticks);
        self.rendered = self.rendered + ticks;
        Run { lines: self.lines, trigger, drivers, ticks: ticks as u32 }
    }

    /// Makes rendering look at the line of `motor` at `tick` or before.
    pub(super) fn change_by(&mut self, motor: usize, tick: Tick) {
        self.changes.by(motor, tick.max(self.rendered).0 as u32);
    }

    /// Sets one line to what its slots give for the rendered end.
    #[inline(never)]
    fn step(&mut self, motor: usize, reporting: &mut Reporting) {
        let now = self.rendered;
        let present = loop {
            let Some(slot) = self.pool.current(motor) else { break None };
            if slot.kind == Kind::Play && slot.charged.is_none() && slot.stroke.up <= now {
                self.begin(motor, reporting);
            } else if let Some(present) = slot.at(now) {
                break Some(present);
            } else {
                self.end(motor);
            }
        };
        let bit = MotorSet::of(motor);
        self.lines.up = self.lines.up.without(bit);
        self.lines.down = self.lines.down.without(bit);
        let Some((line, ticks)) = present else {
            self.changes.forget(motor);
            return;
        };
        if let Line::Pulse(direction) = line {
            *self.lines.set_mut(direction) |= bit;
        }
        self.changes.next(motor, (now.0 as u32).wrapping_add(ticks));
    }

    /// Begins the next stroke of a motor, or refuses it. Not inlined, like [`Self::end`]: most steps need neither.
    #[inline(never)]
    fn begin(&mut self, motor: usize, reporting: &mut Reporting) {
        let Some(slot) = self.pool.current(motor) else { return };
        let (stroke, pushes) = (slot.stroke, slot.pushes);
        let begun = self.allowance.begin_stroke().and_then(|()| self.check_at_once(&stroke));
        let begun = begun
            .and_then(|()| self.allowance.begin(self.rendered, motor, stroke.pulses(), pushes, &self.layout));
        let Some(slot) = self.pool.current_mut(motor) else { return };
        match begun {
            Ok(()) => slot.charged = Some(charge(&stroke)),
            Err(reason) => {
                let up = stroke.up;
                slot.kind = Kind::Void;
                slot.stroke = Stroke { up_pulses: 0, down: up, down_pulses: 0, ..stroke };
                self.next_end = self.next_end.min(up);
                reporting.count().refused += 2;
                reporting.report(Report::Refused { motor: motor as u8, up: up.wire(), reason });
            }
        }
    }

    /// Goes on to the next stroke of a motor.
    #[inline(never)]
    fn end(&mut self, motor: usize) {
        let Some(slot) = self.pool.current_mut(motor) else { return };
        if let Some(charged) = slot.charged.take() {
            let (played, pushes) = (slot.stroke.pulses(), slot.pushes);
            self.allowance.end(self.rendered, motor, (charged, played), (pushes, pushes));
        }
        self.pool.advance(motor);
    }
}
