//! Homing: between plays, moves each pin back to where it ought to rest.
//!
//! One motor after the other, because a move is a command of its own; then, with telemetry, all again, until none is
//! off by more than [`NEAR_UM`] or [`ROUNDS`] are over: each move scatters by a tenth of its way. Without telemetry a
//! calibrated motor is moved once, by what its gains say that strokes have left; the scatter stays. A motor
//! of which neither is known is not moved.

use crate::stream::port::Refused;
use crate::stream::streamer::{Streamer, Taken, Tell, answer};
use crate::units::{HostInstant, UM_PER_PULSE};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Op, State};
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::{TICK_HZ, Tick};

/// A pin that is so near is home, µm.
const NEAR_UM: f64 = 0.5;
/// Rounds over all motors at the most.
const ROUNDS: u8 = 6;
/// From the end of a move until the next one is sent, and until telemetry can show where it led: the window, and a wake-up.
const SETTLED: u64 = 366 + TICK_HZ as u64 / 500;
/// Telemetry that does not come within this after a round does not come.
const SILENT: u64 = TICK_HZ as u64 / 2;

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
            return Err(Refused::Returning);
        }
        if !self.plays.is_empty() {
            return Err(Refused::Playing);
        }
        let Some(tick) = self.status.map(|(_, tick)| tick) else { return Err(Refused::NoDevice) };
        if (0..MOTORS as u8).all(|motor| self.hold.off_by_um(motor).is_none()) {
            return Err(Refused::NothingToGoBy);
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
    pub(super) fn moved(&mut self, now: HostInstant, op: Op, result: Result<(), Refused>, tell: Tell<'_>) {
        let Op::Move { motor, direction, pulses } = op else { return };
        let over = self.tick_at(now).unwrap_or_default() + u64::from(pulses) + SETTLED;
        if result.is_ok() {
            self.hold.moved(motor, direction, pulses, over);
        }
        let Some(homing) = &mut self.homing else { return };
        homing.moving = false;
        homing.motor += 1;
        match result {
            Ok(()) => (homing.moved, homing.until) = (true, over),
            // The others come home all the same.
            Err(Refused::Device(Refusal::Travel)) => homing.beyond = true,
            Err(refused) => self.end_homing(Err(refused), tell),
        }
    }

    pub(super) fn end_homing(&mut self, result: Result<(), Refused>, tell: Tell<'_>) {
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
            let known =
                self.hold.off_by_um(homing.motor).filter(|&(_, measured)| measured || homing.round == 0);
            if let Some((um, _)) = known.filter(|(um, _)| um.abs() > NEAR_UM) {
                let direction = if um > 0.0 { Direction::Down } else { Direction::Up };
                let pulses = (um.abs() / (UM_PER_PULSE * self.hold.gain(homing.motor, direction))).round();
                let pulses = pulses.clamp(1.0, 3000.0) as u16;
                homing.moving = true;
                let op = Op::Move { motor: homing.motor, direction, pulses };
                self.control(now, 0, op, tell);
                return;
            }
            homing.motor += 1;
        }
        if !homing.moved || homing.round + 1 == ROUNDS {
            let beyond = homing.beyond;
            let result = if beyond { Err(Refused::Device(Refusal::Travel)) } else { Ok(()) };
            return self.end_homing(result, tell);
        }
        // The next round goes by what telemetry shows after the last move.
        if self.hold.sampled_after(homing.until) || tick >= homing.until + SILENT {
            (homing.round, homing.motor, homing.moved) = (homing.round + 1, 0, false);
        }
    }
}
