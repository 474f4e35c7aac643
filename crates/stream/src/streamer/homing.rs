//! Homing: between plays, moves each pin back to where it ought to rest.
//!
//! One motor after the other, because a move is a command of its own; then, with telemetry, all again, until none is
//! off by more than [`NEAR_UM`] or [`ROUNDS`] are over: each move scatters by a tenth of its way. Telemetry that does not show
//! a motor's first small move as it ought to is not believed, and the motor not moved again. Without telemetry a
//! calibrated motor is moved once, by what its gains say that strokes have left; the scatter stays. A motor
//! of which neither is known is not moved. If a pin is not home in the end, the answer says so.

use crate::queues::CommandError;
use crate::streamer::{Streamer, Taken, Tell, answer};
use crate::time::HostInstant;
use firmware_protocol::limits::{MAX_TRAVEL, Refusal};
use firmware_protocol::message::{Op, State};
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::Tick;
use meissner_array::motor::WINDOW_TICKS;
use meissner_array::units::{TICKS_PER_MS, TICKS_PER_S, UM_PER_PULSE};

/// A pin that is so near is home, µm, and one that is so near at the end is near enough.
const NEAR_UM: f64 = 0.5;
const NEAR_ENOUGH_UM: f64 = 2.0;
/// The first move goes no further, µm: it shows whether telemetry is the motor's.
const FIRST_UM: f64 = 30.0;
/// Rounds over all motors at the most.
const ROUNDS: u8 = 6;
/// From the end of a move until the next one is sent, and until telemetry can show where it led: the window, and a wake-up.
const SETTLED: u64 = WINDOW_TICKS + 2 * TICKS_PER_MS;
/// Telemetry that does not come within this after a round does not come.
const SILENT: u64 = TICKS_PER_S / 2;

#[derive(Clone, Copy, Debug)]
pub(super) struct Homing {
    ticket: u64,
    round: u8,
    motor: u8,
    /// A pin was moved in this round.
    moved: bool,
    /// A pin is further off than moves may take it.
    beyond: bool,
    /// A move was sent and not answered.
    moving: bool,
    /// When the last move is over.
    until: Tick,
}

impl Streamer {
    /// Begins to home.
    pub(super) fn home(&mut self, ticket: u64) -> Taken {
        self.takes_plays()?;
        if self.state() != State::Armed || !self.may_feed() || self.homing.is_some() {
            return Err(CommandError::Returning);
        }
        if !self.plays.is_empty() {
            return Err(CommandError::Playing);
        }
        let Some(tick) = self.status.map(|(_, tick)| tick) else { return Err(CommandError::NoDevice) };
        if (0..MOTORS as u8).all(|motor| self.control.off_by_um(motor, tick).is_none()) {
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

    /// The device has answered a move, which may have been the last one of a homing that was given up.
    pub(super) fn moved(
        &mut self,
        now: HostInstant,
        op: Op,
        result: Result<(), CommandError>,
        tell: Tell<'_>,
    ) {
        let Op::Move { motor, direction, pulses } = op else { return };
        let over = self.tick_at(now).unwrap_or_default() + u64::from(pulses) + SETTLED;
        if result.is_ok() {
            self.control.moved(motor, direction, pulses, over);
            self.last_move = Some((motor, pulses, over)).filter(|_| direction == Direction::Up);
        }
        let Some(homing) = &mut self.homing else { return };
        homing.moving = false;
        homing.motor += 1;
        match result {
            Ok(()) => (homing.moved, homing.until) = (true, over),
            // The others come home all the same.
            Err(CommandError::Device(Refusal::Travel)) => homing.beyond = true,
            Err(refused) => self.end_homing(Err(refused), tell),
        }
    }

    /// What was going on was cut: a move upwards that was under way has been taken back.
    pub(super) fn undo_move(&mut self, now: HostInstant) {
        let tick = self.tick_at(now).unwrap_or_default();
        if let Some((motor, pulses, over)) = self.last_move.take().filter(|&(_, _, over)| tick < over) {
            self.control.moved(motor, Direction::Down, pulses, over + u64::from(pulses));
        }
    }

    pub(super) fn end_homing(&mut self, result: Result<(), CommandError>, tell: Tell<'_>) {
        if let Some(homing) = self.homing.take() {
            answer(homing.ticket, result, tell);
        }
    }

    /// Sends the next move when the last one is over.
    pub(super) fn go_home(&mut self, now: HostInstant, tick: Tick, tell: Tell<'_>) {
        if self.homing.is_none() || self.state() != State::Armed || !self.may_feed() {
            return;
        }
        let Some(homing) = self.homing.as_mut().filter(|homing| !homing.moving && tick >= homing.until)
        else {
            return;
        };
        while usize::from(homing.motor) < MOTORS {
            // Without telemetry one round is all that can be done.
            let known = self.control.off_by_um(homing.motor, tick);
            let known = known.filter(|&(_, measured)| measured || homing.round == 0);
            if let Some((um, measured)) = known.filter(|(um, _)| um.abs() > NEAR_UM) {
                let direction = if um > 0.0 { Direction::Down } else { Direction::Up };
                let most = if measured && homing.round == 0 { FIRST_UM } else { f64::INFINITY };
                let pulses = (um.abs().min(most)
                    / (UM_PER_PULSE * self.control.gain(homing.motor, direction)))
                .round();
                let pulses = pulses.clamp(1.0, MAX_TRAVEL.into()) as u16;
                homing.moving = true;
                let op = Op::Move { motor: homing.motor, direction, pulses };
                self.control(now, 0, op, tell);
                return;
            }
            homing.motor += 1;
        }
        if !homing.moved || homing.round + 1 == ROUNDS {
            let far = (0..MOTORS as u8).any(|motor| {
                let off = self.control.off_by_um(motor, tick);
                self.control.is_faulted(motor) || off.is_some_and(|(um, _)| um.abs() > NEAR_ENOUGH_UM)
            });
            let result = match (homing.beyond, far) {
                (true, _) => Err(CommandError::Device(Refusal::Travel)),
                (false, true) => Err(CommandError::NotHome),
                (false, false) => Ok(()),
            };
            return self.end_homing(result, tell);
        }
        // The next round goes by what telemetry shows after the last move.
        if self.control.sampled_after(homing.until) || tick >= homing.until + SILENT {
            (homing.round, homing.motor, homing.moved) = (homing.round + 1, 0, false);
        }
    }
}
