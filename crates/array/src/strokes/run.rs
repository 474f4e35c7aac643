//! A compiled pattern: one lane per motor, merged in order of time.
//!
//! Invariant: [`Run::begin`] goes back to the beginning without an allocation, so one run serves every item of its pattern.

use super::drive::NEVER;
use super::error::StrokesError;
use super::lane::Lane;
use super::options::StrokeOptions;
use crate::pattern::Pattern;
use crate::strokes::Stroke;
use firmware_protocol::tick::Tick;

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Run {
    lanes: Vec<Lane>,
    /// When the next stroke of each lane goes up, in pattern time; [`NEVER`] if there is none.
    ups: Vec<u64>,
}

impl Run {
    /// Compiles a pattern; there is no stroke before [`Self::begin`].
    pub(super) fn of(pattern: &Pattern, options: &StrokeOptions) -> Result<Self, StrokesError> {
        let array = pattern.array();
        options.check(array)?;
        let lanes =
            array.numbers().map(|motor| Lane::of(motor, pattern, options)).filter_map(Result::transpose);
        let lanes = lanes.collect::<Result<Vec<_>, _>>()?;
        Ok(Self { ups: vec![NEVER; lanes.len()], lanes })
    }

    /// Begins, or begins again, a play that ends at `end`, in pattern time.
    pub(super) fn begin(&mut self, end: u64) {
        for (lane, up) in self.lanes.iter_mut().zip(&mut self.ups) {
            *up = lane.begin(end);
        }
    }

    /// When the last stroke of a play with `Fit::Cover` and this `end` has ended.
    pub(super) fn covers_until(&self, end: u64) -> Option<u64> {
        self.lanes.iter().filter_map(|lane| lane.covers_until(end)).max()
    }

    pub(super) fn is_over(&self) -> bool {
        self.ups.iter().all(|&up| up == NEVER)
    }

    pub(super) fn drives(&self, motor: u8) -> bool {
        self.lanes.iter().any(|lane| lane.motor() == motor)
    }

    pub(super) fn changes_are_apart(&self, ticks: u64) -> bool {
        self.lanes.iter().all(|lane| lane.changes_are_apart(ticks))
    }

    pub(super) fn end_here(&mut self) {
        self.ups.fill(NEVER);
    }

    /// When the next stroke of `motor` goes up, in pattern time.
    pub(super) fn next_up(&self, motor: u8) -> Option<u64> {
        let lane = self.lanes.iter().position(|lane| lane.motor() == motor)?;
        Some(self.ups[lane]).filter(|&up| up != NEVER)
    }

    /// The next stroke of a play that began at `onset`, and the surplus of its down burst.
    #[inline]
    pub(super) fn next(&mut self, onset: Tick) -> Option<(Stroke, u16)> {
        // Lanes are in order of motor, so among equal ticks the first has the lowest motor number.
        let (mut first, mut earliest) = (0, NEVER);
        for (index, &up) in self.ups.iter().enumerate() {
            if up < earliest {
                (first, earliest) = (index, up);
            }
        }
        if earliest == NEVER {
            return None;
        }
        let lane = &mut self.lanes[first];
        let stroke = lane.stroke(onset);
        let surplus = lane.surplus(stroke.up_pulses);
        self.ups[first] = lane.advance();
        Some((stroke, surplus))
    }
}
