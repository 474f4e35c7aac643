//! Homing: moves each pin back to its rest position, between plays.
//!
//! [`Homing::begin`] starts it; [`Homing::step`] gives one move after the other, since each move is an operation of its
//! own. With telemetry it repeats until every pin is within [`NEAR_UM`] or after [`ROUNDS`] rounds: each move scatters
//! by a tenth of its travel. The first move is small: if telemetry does not show it as expected, that is a sensor
//! fault, and the motor is not moved again. Without telemetry a calibrated motor moves once, by the offset that its
//! gains predict; the scatter stays. A motor without either does not move. On an array with a lower stop none of this is needed:
//! one seek drives all pins down to the stop ([`Op::Seek`]).
//!
//! After a reset it also returns the pins that stand above rest: the device arms, which returns them, and disarms at once, so that
//! it takes no moves.
//!
//! Invariant: the answer is an error unless every pin is home.

use crate::control::PositionControl;
use crate::queues::{CommandError, Emit};
use crate::streamer::operations::answer;
use crate::time::HostInstant;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Cause, Op, State, Status};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use std::time::Duration;

/// A pin this near to rest is not moved, µm; one this near at the end counts as home.
const NEAR_UM: f64 = 0.5;
const NEAR_ENOUGH_UM: f64 = 2.0;
/// Longest first move, µm: it tests the sensor.
const FIRST_UM: f64 = 30.0;
/// Most rounds over all motors.
const ROUNDS: u8 = 6;
/// How long to wait for telemetry after a round, ms.
const SILENT_MS: u64 = 500;

/// Arming again within this time does not seek again: it costs pulses against the stop, which are limited.
const SEEK_EVERY: Duration = Duration::from_secs(1);

/// A homing under way, pin by pin.
#[derive(Clone, Copy, Debug)]
struct Rounds {
    ticket: u64,
    round: u8,
    motor: u8,
    /// A pin was moved in this round.
    moved: bool,
    /// A pin is farther off than moves may take it.
    beyond: bool,
    /// A move is sent and not answered.
    moving: bool,
    /// When the last move is over and visible.
    until: Tick,
}

/// A seek of the lower stop that the device has begun.
#[derive(Clone, Copy, Debug)]
struct Seek {
    /// The request that waits for its end.
    ticket: u64,
    /// It brings pins home; otherwise it is part of an `arm`, which plays may follow.
    homes: bool,
}

/// A reset that returns the pins.
#[derive(Clone, Copy, Debug)]
struct AfterReset {
    /// The request that waits for the end.
    ticket: u64,
    /// The arm is ordered, and the disarm.
    arms: bool,
    disarms: bool,
}

/// What brings pins home on one device: see the module.
#[derive(Debug, Default)]
pub(super) struct Homing {
    rounds: Option<Rounds>,
    seek: Option<Seek>,
    after_reset: Option<AfterReset>,
    /// When the last seek of this connection was over.
    last_seek: Option<HostInstant>,
    /// The last move, if it went up: motor, pulses, its end.
    last_move: Option<(u8, u16, Tick)>,
}

/// Time from the end of a move until telemetry shows its result, ticks: the moving average, and a wake-up.
fn settled(array: Array) -> u64 {
    array.motor().settled_ticks() + array.rate().of_ms(2)
}

/// The longest that homing the pins of an array may take, s: all rounds with the longest moves, or a seek in which all motors take
/// turns.
pub fn longest_homing_s(array: Array) -> f64 {
    let (motor, rate) = (array.motor(), array.rate());
    let moves = array.motors() as u64 * (u64::from(motor.most_pulses) + settled(array));
    let rounds = u64::from(ROUNDS) * (moves + rate.of_ms(SILENT_MS));
    let seek = array.motors() as u64 * u64::from(motor.seek_pulses);
    rate.ticks_to_seconds(rounds.max(seek))
}

impl Homing {
    /// Starts to move pin after pin; `ticket` waits for the end.
    pub(super) const fn begin(&mut self, ticket: u64, tick: Tick) {
        let (moved, beyond, moving) = (false, false, false);
        self.rounds = Some(Rounds { ticket, round: 0, motor: 0, moved, beyond, moving, until: tick });
    }

    /// Whether pins are moved one by one.
    pub(super) const fn is_moving(&self) -> bool {
        self.rounds.is_some()
    }

    /// Whether pins are on their way home.
    pub(super) fn is_under_way(&self) -> bool {
        self.is_moving() || self.seek.is_some_and(|seek| seek.homes)
    }

    /// Answers the request for moves, if there is one.
    pub(super) fn end(&mut self, result: Result<(), CommandError>, emit: &mut dyn Emit) {
        if let Some(rounds) = self.rounds.take() {
            answer(rounds.ticket, result, emit);
        }
    }

    /// A reset is ordered; `ticket` waits until the pins are back.
    pub(super) fn begin_reset(&mut self, ticket: u64, emit: &mut dyn Emit) {
        self.end_reset(Err(CommandError::Returning), emit);
        self.after_reset = Some(AfterReset { ticket, arms: false, disarms: false });
    }

    /// Answers the request that waits for the end of a reset, if there is one.
    pub(super) fn end_reset(&mut self, result: Result<(), CommandError>, emit: &mut dyn Emit) {
        if let Some(reset) = self.after_reset.take() {
            answer(reset.ticket, result, emit);
        }
    }

    /// Whether a reset returns pins.
    pub(super) const fn is_resetting(&self) -> bool {
        self.after_reset.is_some()
    }

    /// The next operation after a reset, with none under way; `arm` is what returns the pins.
    pub(super) fn step_reset(&mut self, status: &Status, arm: Op, emit: &mut dyn Emit) -> Option<Op> {
        let reset = self.after_reset.as_mut()?;
        match status.state {
            State::Disarmed if status.outstanding > 0 && status.position_known && !reset.arms => {
                reset.arms = true;
                return Some(arm);
            }
            State::Armed | State::Returning if reset.arms && !reset.disarms => {
                reset.disarms = true;
                return Some(Op::Disarm(Cause::Request));
            }
            State::Returning => {}
            State::Faulted => self.end_reset(Err(CommandError::Faulted), emit),
            State::Disarmed | State::Armed => self.end_reset(Ok(()), emit),
        }
        None
    }

    /// Whether the last seek is so long ago that something may have moved pins since.
    pub(super) fn needs_seek(&self, now: HostInstant) -> bool {
        self.last_seek.is_none_or(|last| now.since(last) >= SEEK_EVERY)
    }

    /// The device has begun the seek that `op` asks for.
    pub(super) fn begin_seek(&mut self, ticket: u64, op: &Op, emit: &mut dyn Emit) {
        self.end_seek(Err(CommandError::Returning), emit);
        self.seek = Some(Seek { ticket, homes: matches!(op, Op::Seek { .. }) });
    }

    /// Answers the request that waits for a seek, if there is one.
    pub(super) fn end_seek(&mut self, result: Result<(), CommandError>, emit: &mut dyn Emit) {
        if let Some(seek) = self.seek.take() {
            answer(seek.ticket, result, emit);
        }
    }

    /// Once this status shows that a seek is over, pins are at rest; answers the request that waits for it.
    pub(super) fn settle_seek(
        &mut self,
        now: HostInstant,
        status: &Status,
        control: &mut PositionControl,
        emit: &mut dyn Emit,
    ) {
        if self.seek.is_none() || status.state == State::Returning {
            return;
        }
        if status.position_known {
            self.last_seek = Some(now);
            control.assume_rest();
        }
        let armed = status.position_known && status.state == State::Armed;
        self.end_seek(if armed { Ok(()) } else { Err(CommandError::Returning) }, emit);
    }

    /// The device has answered a move that it began at `start`, possibly one of a homing that has ended.
    pub(super) fn moved(
        &mut self,
        start: Tick,
        op: Op,
        result: Result<(), CommandError>,
        control: &mut PositionControl,
        emit: &mut dyn Emit,
    ) {
        let Op::Move { motor, direction, pulses } = op else { return };
        let over = start + u64::from(pulses) + settled(control.array());
        if result.is_ok() {
            control.moved(motor, direction, pulses, start, over);
            self.last_move = Some((motor, pulses, over)).filter(|_| direction == Direction::Up);
        }
        let Some(rounds) = &mut self.rounds else { return };
        rounds.moving = false;
        rounds.motor += 1;
        match result {
            Ok(()) => (rounds.moved, rounds.until) = (true, over),
            // The other pins can still come home.
            Err(CommandError::Device(Refusal::Travel)) => rounds.beyond = true,
            Err(refused) => self.end(Err(refused), emit),
        }
    }

    /// The device was cut: it takes back a move upwards that was under way at `tick`. Returns the motor and the pulses of such a move.
    pub(super) fn undo_move(&mut self, tick: Tick, control: &mut PositionControl) -> Option<(u8, u16)> {
        let (motor, pulses, over) = self.last_move.take().filter(|&(_, _, over)| tick < over)?;
        control.moved(motor, Direction::Down, pulses, tick, over + u64::from(pulses));
        Some((motor, pulses))
    }

    /// The device is gone.
    pub(super) fn disconnected(&mut self, emit: &mut dyn Emit) {
        self.end(Err(CommandError::NoDevice), emit);
        self.end_seek(Err(CommandError::NoDevice), emit);
        self.end_reset(Err(CommandError::NoDevice), emit);
        self.last_seek = None;
    }

    /// The next move, when the last one is over; the answer, when there is none left.
    pub(super) fn step(&mut self, tick: Tick, control: &PositionControl, emit: &mut dyn Emit) -> Option<Op> {
        let rounds = self.rounds.as_mut().filter(|rounds| !rounds.moving && tick >= rounds.until)?;
        let array = control.array();
        while array.has(rounds.motor) {
            // Without telemetry a second round cannot improve anything.
            let known = control.offset_um(rounds.motor, tick);
            let known = known.filter(|&(_, measured)| measured || rounds.round == 0);
            if let Some((um, measured)) = known.filter(|(um, _)| um.abs() > NEAR_UM) {
                let direction = if um > 0.0 { Direction::Down } else { Direction::Up };
                let most = if measured && rounds.round == 0 { FIRST_UM } else { f64::INFINITY };
                let pulses = (um.abs().min(most)
                    / (array.motor().um_per_pulse * control.move_gain(rounds.motor, direction, tick)))
                .round();
                let pulses = pulses.clamp(1.0, array.motor().most_pulses.into()) as u16;
                rounds.moving = true;
                let op = Op::Move { motor: rounds.motor, direction, pulses };
                return Some(op);
            }
            rounds.motor += 1;
        }
        if !rounds.moved || rounds.round + 1 == ROUNDS {
            let far = array.numbers().any(|motor| {
                let off = control.offset_um(motor, tick);
                control.is_faulted(motor) || off.is_some_and(|(um, _)| um.abs() > NEAR_ENOUGH_UM)
            });
            let result = match (rounds.beyond, far) {
                (true, _) => Err(CommandError::Device(Refusal::Travel)),
                (false, true) => Err(CommandError::NotHome),
                (false, false) => Ok(()),
            };
            self.end(result, emit);
            return None;
        }
        // The next round needs telemetry from after the last move.
        if control.sampled_after(rounds.until) || tick >= rounds.until + array.rate().of_ms(SILENT_MS) {
            (rounds.round, rounds.motor, rounds.moved) = (rounds.round + 1, 0, false);
        }
        None
    }
}
