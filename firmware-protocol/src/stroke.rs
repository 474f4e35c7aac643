//! What lines do in a tick.

use crate::array::MotorSet;
use serde::{Deserialize, Serialize};

/// The way a pulse moves the pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Direction {
    /// Towards the finger: the line is high for the short first part of each pulse period, for example 20 %.
    Up,
    /// Away from the finger: high for the longer first part, for example 80 %.
    Down,
}

/// What one line does in one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// Low for the whole pulse period. No line is ever high for a whole period: that would put DC on the piezo.
    Off,
    /// One pulse.
    Pulse(Direction),
}

/// The states of all lines in one tick. A motor is never in both sets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Lines {
    /// Lines that carry an up pulse.
    pub up: MotorSet,
    /// Lines that carry a down pulse.
    pub down: MotorSet,
}

impl Lines {
    /// Every line low.
    pub const OFF: Self = Self { up: MotorSet::EMPTY, down: MotorSet::EMPTY };

    /// The state of the line of `motor`.
    pub fn line(&self, motor: u8) -> Line {
        match (self.up.contains(motor), self.down.contains(motor)) {
            (false, false) => Line::Off,
            (true, false) => Line::Pulse(Direction::Up),
            (_, true) => Line::Pulse(Direction::Down),
        }
    }

    /// Lines that carry a pulse.
    #[inline(always)]
    pub fn pulsing(&self) -> MotorSet {
        self.up | self.down
    }

    /// The lines of one direction.
    pub fn set_mut(&mut self, direction: Direction) -> &mut MotorSet {
        match direction {
            Direction::Up => &mut self.up,
            Direction::Down => &mut self.down,
        }
    }
}
