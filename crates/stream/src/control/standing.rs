//! How high pins stand that a cut has left above rest, until they are back.
//!
//! A cut counts at first for all that a pin may have reached ([`Standing::bound`]). The device says when it has cut, and how many return
//! pulses all pins had together: if the moves explain that, the heights are exact ([`Standing::cut`]).
//!
//! Invariant: if the device tells the truth, no pin stands higher than its height here.

use super::queued::Cutting;
use firmware_protocol::tick::Tick;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;

/// See the module.
#[derive(Debug)]
pub(super) struct Standing {
    /// Pulses above rest.
    heights: PerMotor<u16>,
    /// There was a cut since pins were last at rest.
    is_cut: bool,
    /// When the device has cut what it last reported; the heights are those of this tick.
    reported: Option<Tick>,
}

fn sum(heights: &PerMotor<u16>) -> u32 {
    heights.iter().copied().map(u32::from).sum()
}

impl Standing {
    pub(super) fn none(array: Array) -> Self {
        Self { heights: PerMotor::all(array, 0), is_cut: false, reported: None }
    }

    pub(super) const fn heights(&self) -> &PerMotor<u16> {
        &self.heights
    }

    pub(super) fn highest(&self) -> u16 {
        self.heights.iter().copied().max().unwrap_or(0)
    }

    /// This pin stands at least so high.
    pub(super) fn raise(&mut self, motor: u8, pulses: u16) {
        if let Some(height) = self.heights.get_mut(usize::from(motor)) {
            *height = pulses.max(*height);
            self.is_cut = true;
        }
    }

    /// Moves were cut: each pin may stand as high as `highest` says. The device's report of the cut knows better.
    pub(super) fn bound(&mut self, highest: &PerMotor<u16>) {
        if self.reported.is_none() {
            for (height, &highest) in self.heights.iter_mut().zip(highest) {
                *height = highest.max(*height);
            }
        }
        self.is_cut = true;
    }

    /// The device has reported a cut of moves or of a return, at which so many return pulses were outstanding; `moves` gives the height of
    /// a pin by the moves until then. Returns whether they explain it: if not, a return was cut.
    pub(super) fn cut(&mut self, cut: Cutting, outstanding: u32, moves: impl Fn(u8) -> u16) -> bool {
        let mut by_moves = self.heights;
        for (motor, height) in (0..).zip(&mut by_moves) {
            *height = moves(motor);
        }
        // A return that was cut: all pins have come down at the same time, unless limits made them wait.
        let down = self.reported.map_or(0, |before| u16::try_from(cut.at - before).unwrap_or(u16::MAX));
        let by_return = self.heights.map(|height| height.saturating_sub(down));
        let explained = [by_moves, by_return].map(|heights| sum(&heights) == outstanding);
        match explained {
            [true, _] => self.heights = by_moves,
            [_, true] => self.heights = by_return,
            _ => {
                for (height, &moved) in self.heights.iter_mut().zip(&by_moves) {
                    *height = cap(moved.max(*height), outstanding);
                }
            }
        }
        (self.is_cut, self.reported) = (true, Some(cut.at));
        explained[0]
    }

    /// So many return pulses are outstanding, all in all. If the heights do not explain them, any pin may have up to `most`.
    pub(super) fn bound_by(&mut self, outstanding: u32, most: u16) {
        let is_explained = sum(&self.heights) >= outstanding;
        for height in &mut self.heights {
            *height = cap(if is_explained { *height } else { most }, outstanding);
        }
        self.is_cut = true;
    }

    /// All pins count as at rest.
    pub(super) fn clear(&mut self) {
        self.heights.iter_mut().for_each(|height| *height = 0);
        self.reported = None;
    }

    /// All pins are back. If there was a cut, returns how high they stood.
    pub(super) fn end(&mut self) -> Option<PerMotor<u16>> {
        let heights = self.heights;
        self.clear();
        std::mem::replace(&mut self.is_cut, false).then_some(heights)
    }
}

/// No pin has more return pulses than all together.
fn cap(height: u16, outstanding: u32) -> u16 {
    u16::try_from(outstanding).map_or(height, |outstanding| height.min(outstanding))
}
