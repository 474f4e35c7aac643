//! The reports that the host has not seen yet, in the order of their numbers. They are repeated until it has.
//!
//! Refused moves have a queue of their own, with a place for every move that a host can queue: their reports are never
//! lost. The other reports share [`REPORTS`] places. A full queue loses the newest report; the caller counts it. The
//! controller takes frames of moves only while more than [`RESERVE`] places are free, and reports lowered pins and edges of the trigger input only while
//! [`Reports::has_room`].
//! So onsets and cuts find a place as long as the host reads.
//!
//! Invariant: each report after the last one seen is in exactly one of the two queues. A number that `ring` does not hold is
//! that of a refused move.

use crate::array::Layout;
use crate::controller::POOL;
use crate::controller::newer;
use crate::limits::Refusal;
use crate::message::Report;
use crate::tick::{Tick, WireTick};

/// Most unseen reports besides refused moves; also the most reports sent and not seen yet.
pub const REPORTS: usize = 32;
/// Places reserved for queued onsets and for cuts.
pub(in crate::controller) const RESERVE: usize = 12;
/// Reports of the frame that is being taken: its mark was late, and its verdict.
const OF_FRAME: usize = 2;

/// A queued move that was refused when it was to begin.
#[derive(Clone, Copy, Debug)]
struct RefusedMove {
    tick: WireTick,
    motor: u8,
    reason: Refusal,
}

#[derive(Clone, Debug)]
pub(in crate::controller) struct Reports {
    /// Reports with their numbers.
    ring: heapless::Deque<(u16, Report), REPORTS>,
    refused: heapless::Deque<RefusedMove, POOL>,
    /// Number of the newest report.
    made: u16,
    /// Number of reports, from the oldest, sent since the last repetition.
    sent: usize,
    repeated: Tick,
    /// Ticks after which unseen reports are repeated, once the host is heard again.
    repeat: u32,
}

impl Reports {
    pub(super) const fn new(layout: &Layout) -> Self {
        Self {
            ring: heapless::Deque::new(),
            refused: heapless::Deque::new(),
            made: 0,
            sent: 0,
            repeated: Tick(0),
            repeat: layout.report_repeat(),
        }
    }

    /// Adds a report, not of a refused move. Returns `false` if it is lost.
    #[must_use]
    pub(super) fn push(&mut self, report: Report) -> bool {
        let number = self.made.wrapping_add(1);
        let kept = self.ring.push_back((number, report)).is_ok();
        if kept {
            self.made = number;
        }
        kept
    }

    #[must_use]
    pub(super) fn push_refused(&mut self, motor: u8, tick: WireTick, reason: Refusal) -> bool {
        let kept = self.refused.push_back(RefusedMove { tick, motor, reason }).is_ok();
        if kept {
            self.made = self.made.wrapping_add(1);
        }
        kept
    }

    pub(in crate::controller) fn made(&self) -> u16 {
        self.made
    }

    /// Number of the last report that the host has read or that was cleared.
    pub(in crate::controller) fn read(&self) -> u16 {
        self.made.wrapping_sub(self.unseen() as u16)
    }

    fn unseen(&self) -> usize {
        self.ring.len() + self.refused.len()
    }

    pub(in crate::controller) fn free(&self) -> usize {
        REPORTS - self.ring.len()
    }

    /// Whether there is a place that neither the reserve nor the frame that is being taken may need.
    pub(in crate::controller) fn has_room(&self) -> bool {
        self.free() > RESERVE + OF_FRAME
    }

    /// Refused moves that the host has not seen.
    pub(in crate::controller) fn refused(&self) -> u16 {
        self.refused.len() as u16
    }

    /// Forgets all reports, for a new session.
    pub(super) fn clear(&mut self) {
        self.ring.clear();
        self.refused.clear();
        self.sent = 0;
    }

    /// The host has read all reports up to `seen` and is alive: repeat the others if it is time.
    pub(super) fn seen(&mut self, seen: u16, now: Tick) {
        let mut number = self.read();
        let gone = self.unseen().saturating_sub(self.made.wrapping_sub(seen).into());
        // Up to 32 of them, between two blocks of lines.
        let mut next = self.ring.front().map(|&(number, _)| number);
        for _ in 0..gone {
            number = number.wrapping_add(1);
            if next == Some(number) {
                self.ring.pop_front();
                next = self.ring.front().map(|&(number, _)| number);
            } else {
                self.refused.pop_front();
            }
        }
        self.sent = self.sent.saturating_sub(gone);
        if now - self.repeated >= u64::from(self.repeat) {
            self.sent = 0;
            self.repeated = now;
        }
    }

    /// The next report to send, with its number.
    pub(super) fn next(&mut self, now: Tick) -> Option<(u16, Report)> {
        if self.sent == self.unseen().min(REPORTS) {
            return None;
        }
        let number = self.read().wrapping_add(1 + self.sent as u16);
        // Both queues are in order, so this many of the reports sent came from the ring, and the others were refused moves.
        let before = self.ring.iter().filter(|&&(other, _)| newer(number, other)).count();
        let report = match self.ring.iter().nth(before) {
            Some(&(found, report)) if found == number => report,
            _ => {
                let &RefusedMove { motor, tick, reason } = self.refused.iter().nth(self.sent - before)?;
                Report::Refused { motor, tick, reason }
            }
        };
        if self.sent == 0 {
            self.repeated = now;
        }
        self.sent += 1;
        Some((number, report))
    }
}
