//! Motion that belongs to no play: the return at arming, moves of a pin, and seeks of the lower stop.
//!
//! Invariant: it begins at the rendered end, while no stroke of a play is queued.

use crate::controller::pool::{Kind, Slot};
use crate::controller::{Controller, MAX_HOST_TIMEOUT};
use crate::limits::{MAX_SEEK, MAX_TRAVEL, OnTimeLimits, Refusal};
use crate::message::{Cause, LowerStop, State};
use crate::stroke::{Direction, MOTORS, Stroke};

impl Controller {
    /// Plays the outstanding return pulses or seeks the lower stop, then takes strokes.
    pub(super) fn arm(
        &mut self,
        assume_rest: bool,
        host_timeout: u32,
        limits: OnTimeLimits,
        lower_stop: Option<LowerStop>,
    ) -> Result<(), Refusal> {
        if self.state != State::Disarmed {
            return Err(Refusal::State);
        }
        let LowerStop { pulses_per_s, seek } = lower_stop.unwrap_or(LowerStop { pulses_per_s: 0, seek: 0 });
        self.pushing.set_limit(pulses_per_s);
        if seek > 0 {
            self.seek(seek)?;
        } else if assume_rest {
            self.position_known = true;
            self.outstanding = [0; MOTORS];
            self.travel = [0; MOTORS];
        }
        if !self.position_known && !self.seeks {
            return Err(Refusal::PositionUnknown);
        }
        self.host_timeout = host_timeout.min(MAX_HOST_TIMEOUT);
        self.on_time.set_limits(OnTimeLimits::NONE.min(limits));
        self.cause = Cause::Request;
        if self.seeks {
            return Ok(());
        }
        self.state = State::Armed;
        let outstanding = self.outstanding_total();
        if outstanding > 0 {
            for motor in 0..MOTORS {
                let pulses = core::mem::take(&mut self.outstanding[motor]);
                if pulses > 0 {
                    self.queue_internal(Kind::Internal, motor as u8, Direction::Down, pulses, None);
                }
            }
            (self.state, self.then) = (State::Returning, State::Armed);
            self.report_cut(Cause::Request, true, 0, outstanding, self.rendered);
        }
        Ok(())
    }

    /// Queues a burst at the rendered end that belongs to no play. The queue is empty, so there is a slot.
    fn queue_internal(
        &mut self,
        kind: Kind,
        motor: u8,
        direction: Direction,
        pulses: u16,
        charged: Option<u32>,
    ) {
        let at = self.rendered;
        let stroke = match direction {
            Direction::Up => {
                Stroke { motor, up: at, up_pulses: pulses, down: at + u64::from(pulses), down_pulses: 0 }
            }
            Direction::Down => Stroke { motor, up: at, up_pulses: 0, down: at, down_pulses: pulses },
        };
        self.queue(Slot { charged, ..Slot::new(stroke, kind) });
    }

    /// Shifts the rest position of a pin by one burst.
    pub(super) fn shift(&mut self, motor: u8, direction: Direction, pulses: u16) -> Result<(), Refusal> {
        if self.state != State::Armed || !self.pool.is_empty() {
            return Err(Refusal::State);
        }
        let travel = self.travel.get_mut(usize::from(motor)).ok_or(Refusal::Motor)?;
        let signed = if direction == Direction::Up { i32::from(pulses) } else { -i32::from(pulses) };
        let sum = i32::from(*travel) + signed;
        if sum.unsigned_abs() > MAX_TRAVEL.into() {
            return Err(Refusal::Travel);
        }
        if pulses > 0 {
            let charge = u32::from(pulses);
            self.on_time.begin(self.rendered, motor.into(), charge)?;
            *travel = sum as i16;
            self.queue_internal(Kind::Internal, motor, direction, pulses, Some(charge));
        }
        Ok(())
    }

    /// Drives all pins down to the lower stop. Once they are there, the position is known and no return pulses are outstanding.
    pub(super) fn seek(&mut self, pulses: u16) -> Result<(), Refusal> {
        if pulses == 0 || pulses > MAX_SEEK {
            return Err(Refusal::Travel);
        }
        let charge = u32::from(pulses);
        if !self.pushing.allows_all(self.rendered, charge) {
            return Err(Refusal::Pushing);
        }
        (self.position_known, self.seeks) = (false, true);
        (self.outstanding, self.travel) = ([0; MOTORS], [0; MOTORS]);
        for motor in 0..MOTORS {
            // Like a return, a seek breaks no on-time limit, but counts.
            self.on_time.count(self.rendered, motor, charge);
            self.pushing.begin(self.rendered, motor, charge)?;
            self.queue_internal(Kind::Seek, motor as u8, Direction::Down, pulses, Some(charge));
        }
        (self.state, self.then, self.cause) = (State::Returning, State::Armed, Cause::Request);
        self.report_cut(Cause::Request, true, 0, MOTORS as u32 * charge, self.rendered);
        Ok(())
    }
}
