//! The last bursts that had begun when the queue was last cut: the device reports some of them only after the cut.
//!
//! Invariant: bursts before the pin was last at rest say nothing of its height.

use crate::control::queued::{Forgotten, Queued};
use firmware_protocol::tick::Tick;

/// Bursts that a motor remembers after a cut: those that began until the device said when it cut. It says so within milliseconds.
const CUT: usize = 32;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct LastCut {
    bursts: heapless::Deque<Queued, CUT>,
    /// The level before them, pulses above rest.
    level: u16,
    /// Bursts before this tick are no part of it: the pin was at rest since.
    rested: Tick,
}

impl LastCut {
    /// Remembers the last of these bursts; the first in the queue began at `level`.
    pub(super) fn remember<'a>(&mut self, begun: impl DoubleEndedIterator<Item = &'a Queued>, level: u16) {
        self.bursts.clear();
        for queued in begun.rev().take(CUT) {
            // Cannot fail: there is room for as many.
            let _ = self.bursts.push_front(*queued);
        }
        self.level = self.bursts.front().map_or(level, Queued::level_before);
    }

    /// How many moves the step has that began at this tick.
    pub(super) fn moves_at(&self, begin: Tick) -> Option<usize> {
        let at = self.bursts.iter().position(|queued| queued.burst.start == begin)?;
        Some(1 + usize::from(self.bursts.iter().nth(at + 1).is_some_and(|next| next.joined)))
    }

    /// The device has not played the step that begins at this tick.
    pub(super) fn withdrawn(&mut self, begin: Tick) {
        let mut is_first = false;
        self.bursts.retain(|queued| {
            let is_second = std::mem::replace(&mut is_first, queued.burst.start == begin) && queued.joined;
            !is_first && !is_second
        });
    }

    /// The level at the tick of the cut, pulses above rest.
    pub(super) fn height_at(&self, tick: Tick) -> u16 {
        let mut since = self.bursts.iter().rev().filter(|queued| queued.burst.start >= self.rested);
        since.find(|queued| queued.burst.start < tick).map_or(self.level, |last| last.level_at(tick))
    }

    /// The pin is at rest at `tick`.
    pub(super) const fn returned(&mut self, tick: Tick) {
        (self.level, self.rested) = (0, tick);
    }

    /// Its bursts, unless some were forgotten that began at `from` or later.
    pub(super) fn since(&self, from: Tick) -> Result<impl DoubleEndedIterator<Item = &Queued>, Forgotten> {
        let is_short =
            self.bursts.is_full() && self.bursts.front().is_some_and(|first| first.burst.start >= from);
        if is_short { Err(Forgotten) } else { Ok(self.bursts.iter()) }
    }
}
