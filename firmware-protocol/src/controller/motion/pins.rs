//! Where the pins are: how far above rest, and whether that is known.
//!
//! Invariant: a pin is above its first rest position by the pulses of its `travel`, and above that by its outstanding return pulses,
//! which it keeps until they are driven or a seek begins. While pins seek the lower stop, their position is unknown.

use crate::array::{CAPACITY, Layout};
use crate::controller::player::Left;
use crate::limits::Refusal;
use crate::stroke::Direction;

#[derive(Clone, Debug, Hash)]
pub(in crate::controller) struct Pins {
    position_known: bool,
    /// All pins are being driven down to the lower stop.
    seeks: bool,
    outstanding: [u16; CAPACITY],
    /// How many of the outstanding return pulses push against the lower stop.
    outstanding_pushes: [u16; CAPACITY],
    /// Net pulses of moves since the pins were last at rest.
    travel: [i16; CAPACITY],
}

impl Pins {
    pub(super) const UNKNOWN: Self = Self {
        position_known: false,
        seeks: false,
        outstanding: [0; CAPACITY],
        outstanding_pushes: [0; CAPACITY],
        travel: [0; CAPACITY],
    };

    pub(in crate::controller) fn position_known(&self) -> bool {
        self.position_known
    }

    /// Outstanding return pulses of a pin.
    pub(in crate::controller) fn outstanding(&self, motor: u8) -> u16 {
        self.outstanding.get(usize::from(motor)).copied().unwrap_or(0)
    }

    pub(in crate::controller) fn outstanding_total(&self) -> u32 {
        total(&self.outstanding)
    }

    pub(super) fn lose_position(&mut self) {
        self.position_known = false;
    }

    /// All pins are at rest.
    pub(super) fn assume_rest(&mut self) {
        *self = Self { position_known: true, ..Self::UNKNOWN };
    }

    pub(super) fn begin_seek(&mut self) {
        *self = Self { seeks: true, ..Self::UNKNOWN };
    }

    /// The pins have come to the lower stop, if they were seeking it.
    pub(super) fn finish_seek(&mut self) {
        self.position_known |= core::mem::take(&mut self.seeks);
    }

    /// A seek that was not finished leaves the position unknown.
    pub(super) fn abort_seek(&mut self) {
        self.seeks = false;
    }

    /// The fewest pulses by which all pins are sure to reach the lower stop.
    pub(super) fn least_seek(&self, layout: &Layout) -> u16 {
        if !self.position_known {
            return layout.whole_travel();
        }
        let heights = self.outstanding.iter().zip(self.travel);
        let heights = heights.map(|(&outstanding, travel)| outstanding.saturating_add_signed(travel));
        layout.least_seek(heights.max().unwrap_or(0))
    }

    /// `undone` up pulses of a move were cut, or are driven back by the cut.
    pub(super) fn take_back(&mut self, motor: usize, undone: u16) {
        self.travel[motor] -= undone.cast_signed();
    }

    /// A stroke was turned off.
    pub(super) fn leave(&mut self, motor: usize, left: &Left) {
        self.take_back(motor, left.undone);
        for (sums, pulses) in
            [(&mut self.outstanding, left.outstanding), (&mut self.outstanding_pushes, left.pushes)]
        {
            sums[motor] = sums[motor].saturating_add(pulses);
        }
    }

    /// The outstanding return pulses, and how many of them push, once: they are driven now.
    pub(super) fn take_outstanding(&mut self) -> [[u16; CAPACITY]; 2] {
        [&mut self.outstanding, &mut self.outstanding_pushes]
            .map(|pulses| core::mem::replace(pulses, [0; CAPACITY]))
    }

    /// The travel of a pin after a move, and how many of its pulses push. A pin goes no further down than a lower stop.
    pub(super) fn shifted(
        &self,
        motor: u8,
        direction: Direction,
        pulses: u16,
        has_stop: bool,
        layout: &Layout,
    ) -> Result<(i16, u16), Refusal> {
        let &travel = self.travel[..layout.motors()].get(usize::from(motor)).ok_or(Refusal::Motor)?;
        let signed = if direction == Direction::Up { i32::from(pulses) } else { -i32::from(pulses) };
        // The pin can be below rest only if there was no stop before.
        let from = if has_stop { travel.max(0) } else { travel };
        let sum = i32::from(from) + signed;
        if sum.unsigned_abs() > layout.max_travel().into() {
            return Err(Refusal::Travel);
        }
        // At most the pulses of the move.
        let pushes = if has_stop { (-sum).max(0) as u16 } else { 0 };
        Ok((sum as i16 + pushes.cast_signed(), pushes))
    }

    pub(super) fn set_travel(&mut self, motor: u8, travel: i16) {
        if let Some(place) = self.travel.get_mut(usize::from(motor)) {
            *place = travel;
        }
    }
}

/// The sum over all motors.
pub(super) fn total(pulses: &[u16; CAPACITY]) -> u32 {
    pulses.iter().map(|&pulses| u32::from(pulses)).sum()
}
