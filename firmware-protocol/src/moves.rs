//! Moves: the unit of all motion. A move sets the level that a pin is to have from a tick on.
//!
//! A *level* is a height above rest in pulses. From its tick on, the motor pulses once a tick towards the level, until the pin is there or
//! the motor's next move begins. A stroke is two moves, a ramp is many, a hold is none.

use crate::tick::Tick;
use serde::{Deserialize, Serialize};

/// A pin is to have a level from a tick on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Move {
    /// Its number in the array, from 0, row by row.
    pub motor: u8,
    /// The tick of the first pulse.
    pub tick: Tick,
    /// Pulses above rest.
    pub level: u16,
    /// Pulses after the pin is at rest, which push against a lower stop. 0 unless the level is 0.
    pub surplus: u16,
}
