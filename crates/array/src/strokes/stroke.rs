//! Strokes: excursions of a pin, an up burst and the down burst that undoes it.
//!
//! Drives are compiled to strokes, and position control corrects their bursts. On the wire a stroke is two moves.

use firmware_protocol::array::Layout;
use firmware_protocol::batch::{self, Full, Packer};
use firmware_protocol::limits::Refusal;
use firmware_protocol::stroke::{Direction, Line};
use firmware_protocol::tick::Tick;

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
    pub fn end(&self) -> Tick {
        self.start + u64::from(self.pulses)
    }
}

/// One excursion of one pin. It is valid if [`Stroke::check`] accepts it: `up + up_pulses <= down` and more.
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
    /// Checks a stroke against the controller's limits, and the order of its bursts.
    ///
    /// # Errors
    /// The limit that it breaks; [`Refusal::Surplus`] also if its bursts are not in order, or the pin does not come back to rest.
    pub fn check(&self, layout: &Layout) -> Result<(), Refusal> {
        let packed = self.packed().ok_or(Refusal::Surplus)?;
        packed.moves().iter().try_for_each(|to| layout.check(to))
    }

    /// As it is sent; `None` if its bursts are not in order, or it has more pulses up than down.
    pub fn packed(&self) -> Option<batch::Stroke> {
        let Self { motor, up, up_pulses: level, down, down_pulses } = *self;
        let surplus = down_pulses.checked_sub(level)?;
        let stroke = batch::Stroke { motor, up, level, down, surplus };
        (up + u64::from(level) <= down && level > 0).then_some(stroke)
    }

    /// Appends it to a packed list.
    ///
    /// # Errors
    /// [`Full`] if it does not fit, or is no stroke that can be sent.
    pub fn pack<const N: usize>(&self, into: &mut Packer<N>) -> Result<(), Full> {
        into.stroke(&self.packed().ok_or(Full)?)
    }

    /// The first tick after the stroke. By definition the pin is at rest again.
    pub fn end(&self) -> Tick {
        self.down + u64::from(self.down_pulses)
    }

    /// Pulses of both bursts.
    pub fn pulses(&self) -> u32 {
        u32::from(self.up_pulses) + u32::from(self.down_pulses)
    }

    /// The up burst and the down burst.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stroke_gives_the_line_of_every_tick() {
        let stroke = Stroke { motor: 3, up: Tick(10), up_pulses: 2, down: Tick(14), down_pulses: 3 };
        let lines: Vec<_> = stroke.ticks().map(|(tick, line)| (tick.0, line)).collect();
        let (up, down) = (Line::Pulse(Direction::Up), Line::Pulse(Direction::Down));
        let off = Line::Off;
        assert_eq!(lines, [(10, up), (11, up), (12, off), (13, off), (14, down), (15, down), (16, down)]);
        assert_eq!(stroke.end(), Tick(17));
    }
}
