//! The reports the host has not seen yet: a bounded ring, repeated until seen.
//!
//! A full ring loses the newest report and counts it. Frames of strokes are taken, and single refusals reported,
//! only while more than [`RESERVE`] places are free: onsets and cuts find one as long as the host reads at all.

use crate::message::Report;
use crate::tick::{TICK_HZ, Tick};

/// Unseen reports at the most.
pub const REPORTS: usize = 32;
/// Places kept free for the onsets that may be queued, and for cuts.
pub(super) const RESERVE: usize = 12;
/// A report is repeated after this many ticks, when the host is heard again.
const REPEAT: u64 = TICK_HZ as u64 / 100;

#[derive(Debug)]
pub(super) struct Reports {
    ring: heapless::Deque<Report, REPORTS>,
    /// Number of the newest.
    made: u16,
    /// How many of the ring, from the front, have been sent since the last repetition.
    sent: usize,
    repeated: Tick,
}

impl Reports {
    pub(super) const fn new() -> Self {
        Self { ring: heapless::Deque::new(), made: 0, sent: 0, repeated: Tick(0) }
    }

    /// Adds a report; `false` if it is lost.
    #[must_use]
    pub(super) fn push(&mut self, report: Report) -> bool {
        let kept = self.ring.push_back(report).is_ok();
        if kept {
            self.made = self.made.wrapping_add(1);
        }
        kept
    }

    pub(super) fn made(&self) -> u16 {
        self.made
    }

    /// Number of the last report that nobody waits for: the next is the oldest kept or yet to be made.
    pub(super) fn read(&self) -> u16 {
        self.made.wrapping_sub(self.ring.len() as u16)
    }

    pub(super) fn free(&self) -> usize {
        REPORTS - self.ring.len()
    }

    /// A new session knows nothing of the old one's plays.
    pub(super) fn clear(&mut self) {
        self.ring.clear();
        self.sent = 0;
    }

    /// The host has read all up to number `seen`, and is listening: time to repeat the others.
    pub(super) fn seen(&mut self, seen: u16, now: Tick) {
        let unseen = usize::from(self.made.wrapping_sub(seen));
        if unseen <= self.ring.len() {
            while self.ring.len() > unseen {
                self.ring.pop_front();
                self.sent = self.sent.saturating_sub(1);
            }
        }
        if now - self.repeated >= REPEAT {
            self.sent = 0;
            self.repeated = now;
        }
    }

    /// The next one to send, with its number.
    pub(super) fn next(&mut self, now: Tick) -> Option<(u16, Report)> {
        let report = *self.ring.iter().nth(self.sent)?;
        let behind = self.ring.len() - 1 - self.sent;
        let number = self.made.wrapping_sub(u16::try_from(behind).unwrap_or(0));
        if self.sent == 0 {
            self.repeated = now;
        }
        self.sent += 1;
        Some((number, report))
    }
}
