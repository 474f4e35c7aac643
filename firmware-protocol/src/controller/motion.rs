//! Motion that belongs to no play: the return at arming, moves of a pin, and seeks of the lower stop.
//!
//! Invariant: it begins at the rendered end or when the drivers are ready, while no stroke of a play is queued. Bursts that the limits
//! on motors at once keep apart follow each other without a pause.

use crate::controller::Controller;
use crate::controller::pool::{Kind, Slot};
use crate::limits::{MAX_SEEK, MAX_TRAVEL, PowerLimits, Refusal, WHOLE_TRAVEL, least_seek};
use crate::message::{Cause, LowerStop, State};
use crate::stroke::{Direction, MOTORS, Stroke};

impl Controller {
    /// Plays the outstanding return pulses or seeks the lower stop, then takes strokes.
    pub(super) fn arm(
        &mut self,
        assume_rest: bool,
        host_timeout: u32,
        limits: PowerLimits,
        lower_stop: Option<LowerStop>,
    ) -> Result<(), Refusal> {
        if self.state != State::Disarmed {
            return Err(Refusal::State);
        }
        let LowerStop { pulses_per_s, seek } = lower_stop.unwrap_or(LowerStop { pulses_per_s: 0, seek: 0 });
        self.allowance.set_limits(PowerLimits::NONE.min(limits), pulses_per_s);
        if seek > 0 {
            self.seek(seek)?;
        } else if assume_rest {
            self.position_known = true;
            self.forget_heights();
        }
        if !self.position_known && !self.seeks {
            return Err(Refusal::PositionUnknown);
        }
        self.session.set_host_timeout(host_timeout);
        self.cause = Cause::Request;
        if self.seeks {
            return Ok(());
        }
        self.state = State::Armed;
        let outstanding = self.outstanding_total();
        if outstanding > 0 {
            let mut waiting = 0;
            for motor in 0..MOTORS {
                let pulses = core::mem::take(&mut self.outstanding[motor]);
                let pushes = core::mem::take(&mut self.outstanding_pushes[motor]);
                if pulses > 0 {
                    waiting |= 1 << motor;
                    self.allowance.count(self.rendered, motor, pulses, pushes);
                    self.queue_internal(Kind::Internal, motor as u8, Direction::Down, pulses, pushes);
                }
            }
            self.take_turns(waiting, self.ready());
            (self.state, self.then) = (State::Returning, State::Armed);
            self.report_cut(Cause::Request, true, 0, outstanding, self.rendered);
        }
        Ok(())
    }

    /// All pins are at rest.
    fn forget_heights(&mut self) {
        (self.outstanding, self.outstanding_pushes) = ([0; MOTORS], [0; MOTORS]);
        self.travel = [0; MOTORS];
    }

    /// Queues a burst at [`Controller::ready`] that belongs to no play and was counted; `pushes` of its pulses are against the lower
    /// stop. The queue is empty, so there is a slot.
    fn queue_internal(&mut self, kind: Kind, motor: u8, direction: Direction, pulses: u16, pushes: u16) {
        let at = self.ready();
        let stroke = match direction {
            Direction::Up => {
                Stroke { motor, up: at, up_pulses: pulses, down: at + u64::from(pulses), down_pulses: 0 }
            }
            Direction::Down => Stroke { motor, up: at, up_pulses: 0, down: at, down_pulses: pulses },
        };
        let planned = [pulses.saturating_sub(pushes), stroke.down_pulses];
        self.queue(Slot { charged: Some(pulses), planned, pushes, ..Slot::new(stroke, kind) });
    }

    /// Shifts the rest position of a pin by one burst. At a lower stop a pin goes no further down: the pulses left push.
    pub(super) fn shift(&mut self, motor: u8, direction: Direction, pulses: u16) -> Result<(), Refusal> {
        if self.state != State::Armed || !self.pool.is_empty() {
            return Err(Refusal::State);
        }
        let has_stop = self.allowance.has_stop();
        let travel = self.travel.get_mut(usize::from(motor)).ok_or(Refusal::Motor)?;
        let signed = if direction == Direction::Up { i32::from(pulses) } else { -i32::from(pulses) };
        // The pin can be below rest only if there was no stop before.
        let from = if has_stop { (*travel).max(0) } else { *travel };
        let sum = i32::from(from) + signed;
        if sum.unsigned_abs() > MAX_TRAVEL.into() {
            return Err(Refusal::Travel);
        }
        if pulses > 0 {
            // At most the pulses of the move.
            let pushes = if has_stop { (-sum).max(0) as u16 } else { 0 };
            self.allowance.begin(self.rendered, motor.into(), pulses.into(), pushes)?;
            *travel = sum as i16 + pushes.cast_signed();
            self.queue_internal(Kind::Internal, motor, direction, pulses, pushes);
        }
        Ok(())
    }

    /// Pulses by which the highest pin is above rest, from moves and outstanding return pulses.
    fn height(&self) -> u16 {
        let heights = self.outstanding.iter().zip(self.travel);
        let heights = heights.map(|(&outstanding, travel)| outstanding.saturating_add_signed(travel));
        heights.max().unwrap_or(0)
    }

    /// Drives all pins down to the lower stop. Once they are there, the position is known and no return pulses are outstanding.
    pub(super) fn seek(&mut self, pulses: u16) -> Result<(), Refusal> {
        let least = if self.position_known { least_seek(self.height()) } else { WHOLE_TRAVEL };
        if !(least..=MAX_SEEK).contains(&pulses) {
            return Err(Refusal::Travel);
        }
        let charge = u32::from(pulses);
        if !self.allowance.allows_pushes(self.rendered, charge) {
            return Err(Refusal::Pushing);
        }
        (self.position_known, self.seeks) = (false, true);
        self.forget_heights();
        for motor in 0..MOTORS {
            self.allowance.count(self.rendered, motor, pulses, pulses);
            self.queue_internal(Kind::Seek, motor as u8, Direction::Down, pulses, pulses);
        }
        self.take_turns((1 << MOTORS) - 1, self.ready());
        (self.state, self.then, self.cause) = (State::Returning, State::Armed, Cause::Request);
        self.report_cut(Cause::Request, true, 0, MOTORS as u32 * charge, self.rendered);
        Ok(())
    }
}
