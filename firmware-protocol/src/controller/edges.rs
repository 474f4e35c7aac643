//! Numbers and reports the rising edges of the trigger input.
//!
//! After an edge the input is dead for [`Layout::edge_dead_time`], so a noisy wire makes few reports. An edge moves no pin: what
//! follows from it, the host decides.
//!
//! Invariant: an edge outside the dead time has a number of its own. If its report finds no place, or nobody listens, the number is missing.

use crate::array::Layout;
use crate::message::Report;
use crate::tick::Tick;

#[derive(Clone, Debug)]
pub(super) struct Edges {
    /// Number of the newest edge since boot.
    number: u32,
    /// The first tick in which an edge counts.
    open_from: Tick,
    dead_time: u32,
}

impl Edges {
    pub(super) const fn none(layout: &Layout, now: Tick) -> Self {
        Self { number: 0, open_from: now, dead_time: layout.edge_dead_time() }
    }

    /// The report of an edge, unless it comes within the dead time.
    pub(super) fn count(&mut self, tick: Tick) -> Option<Report> {
        if tick < self.open_from {
            return None;
        }
        self.open_from = tick + u64::from(self.dead_time);
        self.number = self.number.wrapping_add(1);
        Some(Report::Edge { tick: tick.wire(), number: self.number })
    }
}
