//! What the controller holds to, whatever the host asks: the last guard before a finger.
//!
//! A stroke that breaks a limit is refused whole. Corrections stay within [`correction`] pulses of the
//! stroke as planned; rates are pulses begun in any sliding second, counted by [`OnTime`].

use crate::stroke::{MOTORS, Stroke};
use crate::tick::TICK_HZ;
use serde::{Deserialize, Serialize};

/// Up pulses of one stroke at the most: 407 µm, the paper's motors' useful travel.
pub const MAX_UP_PULSES: u16 = 3_000;
/// Net pulses by which moves may take a pin from where it was armed.
pub const MAX_TRAVEL: u16 = 3_000;
/// Motors that share a 30 V supply (a rail).
pub const MOTORS_PER_RAIL: usize = 6;
/// Rails of the array.
pub const RAILS: usize = MOTORS / MOTORS_PER_RAIL;

/// How far a correction may take a count of pulses from the stroke as planned: 30 %, at least 1.
#[must_use]
pub const fn correction(planned: u16) -> u16 {
    let part = planned / 10 * 3 + planned % 10 * 3 / 10;
    if part > 1 { part } else { 1 }
}

/// Whether `count` is within [`correction`] of `planned`.
#[must_use]
pub const fn within_correction(planned: u16, count: u16) -> bool {
    count.abs_diff(planned) <= correction(planned)
}

/// Why a stroke or a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// The controller is not armed.
    NotArmed,
    /// Motor outside 0..24.
    Motor,
    /// No up pulses, or more than [`MAX_UP_PULSES`].
    UpPulses,
    /// The up burst runs into the down burst.
    Bursts,
    /// The down burst undoes the up burst by more than a correction too little or too much.
    Unbalanced,
    /// The stroke begins before the one queued before it on the same motor has ended.
    Overlap,
    /// The stroke begins more than 2^30 ticks ahead.
    TooFar,
    /// No free slot.
    PoolFull,
    /// The motor's pulses in a sliding second.
    MotorOnTime,
    /// The rail's pulses in a sliding second.
    RailOnTime,
    /// Arm asked for while the position is unknown, without `assume_rest`.
    PositionUnknown,
    /// The command does not fit the state (arm while armed or faulted, move while strokes are queued).
    State,
    /// A move beyond [`MAX_TRAVEL`].
    Travel,
    /// The lines of a batch could not be read.
    Malformed,
}

/// Pulses begun per sliding second, at the most. The defaults can never be reached: a site lowers them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OnTimeLimits {
    /// Per motor, pulses/s.
    pub motor: u32,
    /// Per rail (6 motors), pulses/s.
    pub rail: u32,
}

impl OnTimeLimits {
    /// Every tick a pulse on every motor.
    pub const NONE: Self = Self { motor: TICK_HZ, rail: MOTORS_PER_RAIL as u32 * TICK_HZ };

    /// The lower of both, limit by limit.
    #[must_use]
    pub fn min(self, other: Self) -> Self {
        Self { motor: self.motor.min(other.motor), rail: self.rail.min(other.rail) }
    }
}

/// Checks a stroke by itself: its motor, its counts, its order.
///
/// # Errors
/// The first limit it breaks.
pub fn check(stroke: &Stroke) -> Result<(), Refusal> {
    if usize::from(stroke.motor) >= MOTORS {
        return Err(Refusal::Motor);
    }
    if stroke.up_pulses == 0 || stroke.up_pulses > MAX_UP_PULSES {
        return Err(Refusal::UpPulses);
    }
    if stroke.up + u64::from(stroke.up_pulses) > stroke.down {
        return Err(Refusal::Bursts);
    }
    if !within_correction(stroke.up_pulses, stroke.down_pulses) {
        return Err(Refusal::Unbalanced);
    }
    Ok(())
}
