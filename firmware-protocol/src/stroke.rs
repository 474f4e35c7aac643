//! Strokes: what motors play, and what a line does in each tick of a stroke.
//!
//! A stroke is one excursion of one pin: an up burst and the down burst that undoes it. The host compiles patterns to
//! strokes, the controller plays them, and tests compare both with [`Stroke::ticks`]. There is no other definition.

use crate::array::MotorSet;
use crate::tick::Tick;
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

/// A train of pulses in one direction, one pulse per tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Burst {
    /// The tick of the first pulse.
    pub start: Tick,
    /// The way it moves the pin.
    pub direction: Direction,
    /// Number of pulses, and of ticks.
    pub pulses: u16,
}

impl Burst {
    /// The first tick after the last pulse.
    #[must_use]
    pub fn end(&self) -> Tick {
        self.start + u64::from(self.pulses)
    }
}

/// One excursion of one pin. It is valid if [`crate::array::Layout::check`] accepts it: `up + up_pulses <= down` and more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Stroke {
    /// Its number in the array, from 0, row by row.
    pub motor: u8,
    /// Start of the up burst.
    pub up: Tick,
    /// Pulses of the up burst.
    pub up_pulses: u16,
    /// Start of the down burst.
    pub down: Tick,
    /// Pulses of the down burst.
    pub down_pulses: u16,
}

impl Stroke {
    /// The first tick after the stroke. By definition the pin is at rest again.
    #[must_use]
    pub fn end(&self) -> Tick {
        self.down + u64::from(self.down_pulses)
    }

    /// Pulses of both bursts.
    #[must_use]
    pub fn pulses(&self) -> u32 {
        u32::from(self.up_pulses) + u32::from(self.down_pulses)
    }

    /// The up burst and the down burst.
    #[must_use]
    pub fn bursts(&self) -> [Burst; 2] {
        [
            Burst { start: self.up, direction: Direction::Up, pulses: self.up_pulses },
            Burst { start: self.down, direction: Direction::Down, pulses: self.down_pulses },
        ]
    }

    /// The state of the stroke's line in every tick from its first pulse to its last.
    pub fn ticks(&self) -> impl Iterator<Item = (Tick, Line)> + use<> {
        let [up, down] = self.bursts();
        (up.start.0..self.end().0).map(move |tick| {
            let line = if tick < up.end().0 {
                Line::Pulse(Direction::Up)
            } else if tick < down.start.0 {
                Line::Off
            } else {
                Line::Pulse(Direction::Down)
            };
            (Tick(tick), line)
        })
    }
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
    #[must_use]
    pub fn line(&self, motor: u8) -> Line {
        match (self.up.contains(motor), self.down.contains(motor)) {
            (false, false) => Line::Off,
            (true, false) => Line::Pulse(Direction::Up),
            (_, true) => Line::Pulse(Direction::Down),
        }
    }

    /// Lines that carry a pulse.
    #[must_use]
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stroke_gives_the_line_of_every_tick() {
        let stroke = Stroke { motor: 3, up: Tick(10), up_pulses: 2, down: Tick(14), down_pulses: 3 };
        let lines: heapless::Vec<_, 16> = stroke.ticks().map(|(tick, line)| (tick.0, line)).collect();
        let (up, down) = (Line::Pulse(Direction::Up), Line::Pulse(Direction::Down));
        let off = Line::Off;
        assert_eq!(lines, [(10, up), (11, up), (12, off), (13, off), (14, down), (15, down), (16, down)]);
        assert_eq!(stroke.end(), Tick(17));
    }
}
