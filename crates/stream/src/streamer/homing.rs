//! Homing: moves each pin back to its rest position, between plays.
//!
//! [`Streamer::home`] starts it; [`Streamer::step_homing`] sends one move after the other, since each move is an operation of its
//! own. With telemetry it repeats until every pin is within [`NEAR_UM`] or after [`ROUNDS`] rounds: each move scatters
//! by a tenth of its travel. The first move is small: if telemetry does not show it as expected, that is a sensor
//! fault, and the motor is not moved again. Without telemetry a calibrated motor moves once, by the offset that its
//! gains predict; the scatter stays. A motor without either does not move. On an array with a lower stop none of this is needed:
//! one seek drives all pins down to the stop ([`Streamer::home_by_stop`]).
//!
//! Invariant: the answer is an error unless every pin is home.

use crate::queues::{CommandError, Emit};
use crate::streamer::{Homing, OpResult, Streamer, answer};
use crate::time::HostInstant;
use firmware_protocol::limits::{MAX_TRAVEL, Refusal};
use firmware_protocol::message::{Op, State};
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::Tick;
use meissner_array::motor::WINDOW_TICKS;
use meissner_array::units::{TICKS_PER_MS, TICKS_PER_S, UM_PER_PULSE};
use std::time::Duration;

/// A pin this near to rest is not moved, µm; one this near at the end counts as home.
const NEAR_UM: f64 = 0.5;
const NEAR_ENOUGH_UM: f64 = 2.0;
/// Longest first move, µm: it tests the sensor.
const FIRST_UM: f64 = 30.0;
/// Most rounds over all motors.
const ROUNDS: u8 = 6;
/// Time from the end of a move until telemetry shows its result, ticks: the moving average, and a wake-up.
const SETTLED: u64 = WINDOW_TICKS + 2 * TICKS_PER_MS;
/// How long to wait for telemetry after a round, ticks.
const SILENT: u64 = TICKS_PER_S / 2;

/// Arming again within this time does not seek again: it costs pulses against the stop, which are limited.
const SEEK_EVERY: Duration = Duration::from_secs(1);

/// A seek of the lower stop that the device has begun.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seek {
    /// The request that waits for its end.
    pub(super) ticket: u64,
    /// It brings pins home; otherwise it is part of an `arm`, which plays may follow.
    pub(super) homes: bool,
}

/// Whether an operation seeks the lower stop.
pub(super) fn seeks(op: &Op) -> bool {
    match op {
        Op::Arm { lower_stop, .. } => lower_stop.is_some_and(|stop| stop.seek > 0),
        op => matches!(op, Op::Seek { .. }),
    }
}

impl Streamer {
    /// Starts homing.
    pub(super) fn home(&mut self, ticket: u64) -> OpResult {
        self.takes_plays()?;
        if self.state() != State::Armed || !self.operations.is_empty() || self.homing.is_some() {
            return Err(CommandError::Returning);
        }
        if !self.plays.is_empty() {
            return Err(CommandError::Playing);
        }
        let Some(tick) = self.known.status().map(|(_, tick)| tick) else {
            return Err(CommandError::NoDevice);
        };
        if (0..MOTORS as u8).all(|motor| self.control.offset_um(motor, tick).is_none()) {
            return Err(CommandError::NoPositionEstimate);
        }
        self.homing = Some(Homing {
            ticket,
            round: 0,
            motor: 0,
            moved: false,
            beyond: false,
            moving: false,
            until: tick,
        });
        Ok(None)
    }

    /// Homes all pins by driving them down to the lower stop.
    pub(super) fn home_by_stop(&self) -> OpResult {
        self.takes_plays()?;
        if self.state() != State::Armed || !self.operations.is_empty() {
            return Err(CommandError::Returning);
        }
        if !self.plays.is_empty() {
            return Err(CommandError::Playing);
        }
        Ok(Some(Op::Seek { pulses: self.settings.seek_pulses() }))
    }

    /// Whether pins are on their way home, or about to be.
    pub(super) fn is_homing(&self) -> bool {
        self.operations.will_seek() || self.homing.is_some() || self.seek.is_some_and(|seek| seek.homes)
    }

    /// Whether arming has to seek the lower stop: nothing tells where pins are, or something may have moved them.
    pub(super) fn needs_seek(&self, now: HostInstant) -> bool {
        let is_known = self.known.status().is_some_and(|(status, _)| status.position_known);
        !is_known || self.last_seek.is_none_or(|last| now.since(last) >= SEEK_EVERY)
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

    /// Once a seek is over, pins are at rest; answers the request that waits for it.
    pub(super) fn settle_seek(&mut self, now: HostInstant, emit: &mut dyn Emit) {
        let Some((status, _)) = self.known.status().filter(|(status, _)| status.state != State::Returning)
        else {
            return;
        };
        if self.seek.is_none() {
            return;
        }
        if status.position_known {
            self.last_seek = Some(now);
            self.control.assume_rest();
        }
        let armed = status.position_known && status.state == State::Armed;
        self.end_seek(if armed { Ok(()) } else { Err(CommandError::Returning) }, emit);
    }

    /// The device has answered a move, possibly of a homing that has ended.
    pub(super) fn moved(
        &mut self,
        now: HostInstant,
        op: Op,
        result: Result<(), CommandError>,
        emit: &mut dyn Emit,
    ) {
        let Op::Move { motor, direction, pulses } = op else { return };
        let start = self.tick_at(now).unwrap_or_default();
        let over = start + u64::from(pulses) + SETTLED;
        if result.is_ok() {
            self.control.moved(motor, direction, pulses, start, over);
            self.last_move = Some((motor, pulses, over)).filter(|_| direction == Direction::Up);
        }
        let Some(homing) = &mut self.homing else { return };
        homing.moving = false;
        homing.motor += 1;
        match result {
            Ok(()) => (homing.moved, homing.until) = (true, over),
            // The other pins can still come home.
            Err(CommandError::Device(Refusal::Travel)) => homing.beyond = true,
            Err(refused) => self.end_homing(Err(refused), emit),
        }
    }

    /// The device was cut: it takes back a move upwards that was under way.
    pub(super) fn undo_move(&mut self, now: HostInstant) {
        let tick = self.tick_at(now).unwrap_or_default();
        if let Some((motor, pulses, over)) = self.last_move.take().filter(|&(_, _, over)| tick < over) {
            self.control.moved(motor, Direction::Down, pulses, tick, over + u64::from(pulses));
        }
    }

    /// Answers a homing, if there is one.
    pub(super) fn end_homing(&mut self, result: Result<(), CommandError>, emit: &mut dyn Emit) {
        if let Some(homing) = self.homing.take() {
            answer(homing.ticket, result, emit);
        }
    }

    /// Sends the next move when the last one is over.
    pub(super) fn step_homing(&mut self, now: HostInstant, tick: Tick, emit: &mut dyn Emit) {
        if self.homing.is_none() || self.state() != State::Armed || !self.operations.is_empty() {
            return;
        }
        let Some(homing) = self.homing.as_mut().filter(|homing| !homing.moving && tick >= homing.until)
        else {
            return;
        };
        while usize::from(homing.motor) < MOTORS {
            // Without telemetry a second round cannot improve anything.
            let known = self.control.offset_um(homing.motor, tick);
            let known = known.filter(|&(_, measured)| measured || homing.round == 0);
            if let Some((um, measured)) = known.filter(|(um, _)| um.abs() > NEAR_UM) {
                let direction = if um > 0.0 { Direction::Down } else { Direction::Up };
                let most = if measured && homing.round == 0 { FIRST_UM } else { f64::INFINITY };
                let pulses = (um.abs().min(most)
                    / (UM_PER_PULSE * self.control.move_gain(homing.motor, direction, tick)))
                .round();
                let pulses = pulses.clamp(1.0, MAX_TRAVEL.into()) as u16;
                homing.moving = true;
                let op = Op::Move { motor: homing.motor, direction, pulses };
                self.queue_op(now, 0, op, emit);
                return;
            }
            homing.motor += 1;
        }
        if !homing.moved || homing.round + 1 == ROUNDS {
            let far = (0..MOTORS as u8).any(|motor| {
                let off = self.control.offset_um(motor, tick);
                self.control.is_faulted(motor) || off.is_some_and(|(um, _)| um.abs() > NEAR_ENOUGH_UM)
            });
            let result = match (homing.beyond, far) {
                (true, _) => Err(CommandError::Device(Refusal::Travel)),
                (false, true) => Err(CommandError::NotHome),
                (false, false) => Ok(()),
            };
            return self.end_homing(result, emit);
        }
        // The next round needs telemetry from after the last move.
        if self.control.sampled_after(homing.until) || tick >= homing.until + SILENT {
            (homing.round, homing.motor, homing.moved) = (homing.round + 1, 0, false);
        }
    }
}
