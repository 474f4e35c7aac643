//! A bounded queue of the reports that the host has not seen yet. They are repeated until it has.
//!
//! A full queue loses the newest report; the caller counts it. The controller takes frames of strokes and reports single
//! refusals only while more than [`RESERVE`] places are free. So onsets and cuts find a place as long as the host reads.

use crate::message::Report;
use crate::tick::{TICK_HZ, Tick};

/// Most unseen reports.
pub const REPORTS: usize = 32;
/// Places reserved for queued onsets and for cuts.
pub(super) const RESERVE: usize = 12;
/// Ticks after which unseen reports are repeated, once the host is heard again.
const REPEAT: u64 = TICK_HZ as u64 / 100;

#[derive(Debug)]
pub(super) struct Reports {
    ring: heapless::Deque<Report, REPORTS>,
    /// Number of the newest report.
    made: u16,
    /// Number of reports, from the front, sent since the last repetition.
    sent: usize,
    repeated: Tick,
}

impl Reports {
    pub(super) const fn new() -> Self {
        Self { ring: heapless::Deque::new(), made: 0, sent: 0, repeated: Tick(0) }
    }

    /// Adds a report. Returns `false` if it is lost.
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

    /// Number of the last report that the host has read or that was cleared.
    pub(super) fn read(&self) -> u16 {
        self.made.wrapping_sub(self.ring.len() as u16)
    }

    pub(super) fn free(&self) -> usize {
        REPORTS - self.ring.len()
    }

    /// Forgets all reports, for a new session.
    pub(super) fn clear(&mut self) {
        self.ring.clear();
        self.sent = 0;
    }

    /// The host has read all reports up to `seen` and is alive: repeat the others if it is time.
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

    /// The next report to send, with its number.
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
