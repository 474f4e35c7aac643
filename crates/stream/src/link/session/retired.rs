//! The frames that had no verdict when a command ended their epoch.
//!
//! The device may have refused strokes of them before it read the command, and its reports may come after. What no report names
//! was taken, or not played because of the command: nothing is emitted of it.
//!
//! Invariant: at most one verdict of a frame is emitted.

use crate::link::session::batch::{Batch, kept_motors};
use crate::link::session::event::{Event, Verdict};
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::controller::REPORTS;
use firmware_protocol::message::Report;
use firmware_protocol::tick::Tick;
use std::collections::VecDeque;

/// The frames of the epoch that was ended last.
#[derive(Clone, Debug)]
pub(super) struct Retired {
    frames: VecDeque<Batch>,
    /// The motors whose old strokes the device had kept before the first of them.
    kept: MotorSet,
    /// Their verdicts that are read and not emitted. There is at most one for a frame.
    verdicts: VecDeque<Report>,
    /// Reports up to this one are about earlier epochs.
    after: u16,
}

impl Retired {
    /// None, with room for so many frames.
    pub(super) fn new(frames: usize) -> Self {
        Self {
            frames: VecDeque::with_capacity(frames),
            kept: MotorSet::EMPTY,
            verdicts: VecDeque::with_capacity(REPORTS),
            after: 0,
        }
    }

    /// Takes the frames of the epoch that ends, and their verdicts that are read, in exchange for its own. Reports up to `after`
    /// are about earlier epochs.
    pub(super) fn take(
        &mut self,
        frames: &mut VecDeque<Batch>,
        verdicts: &mut VecDeque<Report>,
        kept: MotorSet,
        after: u16,
    ) {
        std::mem::swap(&mut self.frames, frames);
        std::mem::swap(&mut self.verdicts, verdicts);
        (self.kept, self.after) = (kept, after);
    }

    /// Takes a verdict, the report of this number.
    pub(super) fn judge(&mut self, number: u16, report: Report) {
        let is_later = (1..=u16::MAX / 2).contains(&number.wrapping_sub(self.after));
        if is_later && self.verdicts.len() < REPORTS {
            self.verdicts.push_back(report);
        }
    }

    /// Emits the verdicts late and refused that were read.
    pub(super) fn conclude(&mut self, tick: Tick, now: HostInstant, emit: &mut dyn FnMut(Event)) {
        while let Some(report) = self.verdicts.pop_front() {
            let Report::Verdict { seq, .. } = report else { continue };
            let Some(found) = self.frames.iter().position(|batch| batch.seq() == seq) else { continue };
            // Frames before it without a report were taken as sent.
            for before in self.frames.iter().take(found) {
                self.kept = self.kept.without(before.withdraws().unwrap_or_default());
            }
            let Some(batch) = self.frames.remove(found) else { continue };
            self.kept = self.kept.without(batch.withdraws().unwrap_or_default()) | kept_motors(Some(report));
            batch
                .verdicts(Some(report), self.kept, tick, now)
                .filter(|(_, verdict)| *verdict != Verdict::Accepted)
                .for_each(|(step, verdict)| emit(Event::Step(step, verdict)));
        }
    }
}
