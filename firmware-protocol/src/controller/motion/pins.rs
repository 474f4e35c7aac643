//! Whether it is known where the pins are, and how far `Op::Move` has shifted where they rest.
//!
//! How high a pin is above rest is the player's to know. Invariant: while pins seek the lower stop, their position is unknown.

use crate::array::{CAPACITY, Layout};
use crate::controller::player::Shifting;
use crate::limits::Refusal;
use crate::stroke::Direction;

#[derive(Clone, Debug)]
pub(in crate::controller) struct Pins {
    position_known: bool,
    /// All pins are being driven down to the lower stop.
    seeks: bool,
    /// Net pulses by which rest was shifted.
    travel: [i16; CAPACITY],
}

impl Pins {
    pub(super) const UNKNOWN: Self = Self { position_known: false, seeks: false, travel: [0; CAPACITY] };

    pub(in crate::controller) fn position_known(&self) -> bool {
        self.position_known
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

    pub(in crate::controller) fn seeks(&self) -> bool {
        self.seeks
    }

    /// The pins have come to the lower stop, if they were seeking it.
    pub(super) fn finish_seek(&mut self) {
        self.position_known |= core::mem::take(&mut self.seeks);
    }

    /// A seek that was not finished leaves the position unknown.
    pub(super) fn abort_seek(&mut self) {
        self.seeks = false;
    }

    /// The fewest pulses by which all pins are sure to reach the lower stop; `height` gives a pin's pulses above rest.
    pub(super) fn least_seek(&self, layout: &Layout, height: impl Fn(usize) -> u16) -> u16 {
        if !self.position_known {
            return layout.whole_travel();
        }
        let heights =
            (0..).zip(self.travel).map(|(motor, travel)| height(motor).saturating_add_signed(travel));
        layout.least_seek(heights.max().unwrap_or(0))
    }

    /// A shift upwards that was under way is driven back, or was not played.
    pub(super) fn take_back(&mut self, of: Shifting) {
        self.travel[usize::from(of.motor)] -= of.pulses.cast_signed();
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
