//! The strokes on their way: frames that are filled, sent, sent again, and judged; and the amendments.
//!
//! The session says which frames the device has acknowledged and which reports it has read; the outbox says which frame is to be
//! sent, and emits the verdicts. It knows no commands: [`Outbox::begin_epoch`] ends all that is under way.
//!
//! Invariant: frames are judged in the order of their numbers, each once. There are at most [`WINDOW`], and never more strokes in
//! them than the device has credits.

use crate::link::session::batch::{Batch, Head, Written, judged, kept_motors};
use crate::link::session::event::Event;
use crate::link::session::retired::Retired;
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer};
use firmware_protocol::controller::{REORDER_WINDOW, REPORTS};
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::{Mark, Report, Status};
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Step;
use std::collections::VecDeque;
use std::time::Duration;

/// Unacknowledged frames at most: the next in order, and those the device keeps out of order (selective repeat).
const WINDOW: usize = 1 + REORDER_WINDOW;

/// The frames of the present epoch, and those that the last command ended.
#[derive(Clone, Debug)]
pub(super) struct Outbox {
    window: VecDeque<Batch>,
    open: Option<Batch>,
    /// A replacement that is not in frames yet: from which tick on, and the motors.
    replacing: Option<(Tick, MotorSet)>,
    /// The motors whose old strokes the device keeps: it takes no others until it is asked to withdraw again.
    kept: MotorSet,
    next_seq: u16,
    /// The device acknowledged all frames before this one.
    acked: u16,
    /// The device's free stroke slots, after the frames before `acked`.
    credits: usize,
    amendments: Packer<BATCH_BYTES>,
    generation: u16,
    /// Verdicts that came before their acknowledgement.
    verdicts: VecDeque<Report>,
    retired: Retired,
}

impl Outbox {
    pub(super) fn new() -> Self {
        Self {
            window: VecDeque::with_capacity(WINDOW + 1),
            open: None,
            replacing: None,
            kept: MotorSet::EMPTY,
            next_seq: 0,
            acked: 0,
            credits: 0,
            amendments: Packer::new(Tick(0)),
            generation: 0,
            verdicts: VecDeque::with_capacity(REPORTS),
            retired: Retired::new(WINDOW + 1),
        }
    }

    /// A new epoch: nothing of the old one is sent any more. `retires`: its frames may still be judged, by reports after this one.
    pub(super) fn begin_epoch(&mut self, retires: Option<u16>) {
        if let Some(after) = retires {
            self.retired.take(&mut self.window, &mut self.verdicts, self.kept, after);
        }
        self.drop_frames();
        self.verdicts.clear();
        (self.kept, self.next_seq, self.acked, self.generation) = (MotorSet::EMPTY, 0, 0, 0);
        self.amendments = Packer::new(Tick(0));
    }

    /// Sends no frame any more.
    pub(super) fn drop_frames(&mut self) {
        self.window.clear();
        (self.open, self.replacing) = (None, None);
    }

    /// Whether no frame waits for its verdict.
    pub(super) fn is_empty(&self) -> bool {
        self.window.is_empty()
    }

    /// Begins a frame with a mark.
    pub(super) fn begin(&mut self, onset: Tick, mark: Mark) {
        self.seal();
        self.open = Some(Batch::new(self.next_seq, onset, Some(mark), None));
    }

    /// Begins a replacement: see [`Session::replace`](super::Session::replace).
    pub(super) fn replace(&mut self, from: Tick, motors: MotorSet, silent: MotorSet) {
        self.seal();
        self.open = Some(Batch::new(self.next_seq, from, None, Some(motors & silent)));
        self.replacing = Some((from, motors.without(silent))).filter(|(_, motors)| !motors.is_empty());
    }

    /// Moves that the device's credits still allow.
    pub(super) fn credits(&self) -> usize {
        let under_way: usize = self.window.iter().chain(&self.open).map(Batch::moves).sum();
        self.credits.saturating_sub(under_way)
    }

    /// Whether a frame may be begun: the window has room, and no onset waits for its verdict.
    pub(super) fn has_room(&self) -> bool {
        self.window.len() < WINDOW && !self.window.back().is_some_and(Batch::is_onset)
    }

    /// Takes a step, in frames of at most `longest` bytes; `false` if it must wait for credits, the window or an onset's verdict.
    pub(super) fn push(&mut self, step: &Step, longest: usize) -> bool {
        if !self.has_room() || self.credits() < step.moves() {
            return false;
        }
        let mut bit = MotorSet::EMPTY;
        bit.insert(step.motor());
        if let Some(batch) = &mut self.open {
            if batch.push(step, longest) {
                // The first step of a motor takes the place of its old ones.
                if let Some((from, motors)) = self.replacing
                    && batch.withdraw(bit & motors)
                {
                    self.replacing =
                        Some((from, motors.without(bit))).filter(|(_, motors)| !motors.is_empty());
                }
                return true;
            }
            self.seal();
            return self.push(step, longest);
        }
        if let Some((from, _)) = self.replacing {
            self.open = Some(Batch::new(self.next_seq, from, None, Some(MotorSet::EMPTY)));
            return self.push(step, longest);
        }
        // A frame that waits takes more steps: on a link with slow answers frames get longer, not more.
        if self.window.back_mut().is_some_and(|last| last.extend(step, longest)) {
            return true;
        }
        let batch = self.open.insert(Batch::new(self.next_seq, step.begin(), None, None));
        batch.push(step, longest)
    }

    /// Ends the open frame, so that it can be sent.
    pub(super) fn seal(&mut self) {
        if let Some(batch) = self.open.take() {
            self.next_seq = self.next_seq.wrapping_add(1);
            self.window.push_back(batch);
        }
    }

    /// Adds a corrected pulse count to the next amendments; `false` if they are full.
    pub(super) fn amend(&mut self, amendment: &Amendment) -> bool {
        if self.amendments.count() == 0 {
            self.amendments = Packer::new(amendment.tick);
        }
        self.amendments.amendment(amendment).is_ok()
    }

    /// The amendments that wait, and their generation. They count as sent.
    pub(super) fn next_amendments(&mut self) -> Option<(u16, Packer<BATCH_BYTES>)> {
        if self.amendments.count() == 0 {
            return None;
        }
        self.generation = self.generation.wrapping_add(1);
        Some((self.generation, std::mem::replace(&mut self.amendments, Packer::new(Tick(0)))))
    }

    /// Writes the next frame that the device misses, new or lost on the way: a lost one once `retry` has passed, a new one while
    /// at most `window_bytes` are unacknowledged.
    pub(super) fn write_next(
        &mut self,
        now: HostInstant,
        head: Head,
        retry: Duration,
        window_bytes: usize,
        out: &mut [u8],
    ) -> Option<Written> {
        let mut unacknowledged = 0;
        let mut next = None;
        for batch in self.window.iter_mut().filter(|batch| batch.is_missing(self.acked)) {
            if !batch.is_due(now, retry) {
                unacknowledged += batch.bytes_under_way();
            } else if next.is_none() {
                next = Some(batch);
            }
        }
        let next = next?;
        // A missing frame must not wait for the frames after it.
        if !next.is_retransmitted() && unacknowledged > 0 && unacknowledged + MAX_FRAME > window_bytes {
            return None;
        }
        // No amendment of a stroke of this frame is sent before its verdict, so the amendments up to now concern old strokes.
        Some(next.write(now, head, self.generation, out))
    }

    /// When [`Self::write_next`] may have a frame, if no answer comes.
    pub(super) fn due(&self, now: HostInstant, retry: Duration) -> Option<HostInstant> {
        let missing = self.window.iter().find(|batch| batch.is_missing(self.acked));
        missing.map(|batch| batch.due(now, retry))
    }

    /// Bytes that are sent and not with the device, as far as it has said.
    pub(super) fn bytes_under_way(&self) -> usize {
        self.window.iter().map(Batch::bytes_under_way).sum()
    }

    /// The device acknowledged all frames before this one.
    pub(super) const fn acked(&self) -> u16 {
        self.acked
    }

    /// Frames from [`Self::acked`] on that were sent.
    pub(super) fn unacknowledged(&self) -> usize {
        let last = self.window.iter().rev().find(|batch| batch.is_sent());
        last.map_or(0, |last| last.seq().wrapping_add(1).wrapping_sub(self.acked).into())
    }

    /// Takes over what a status of this epoch acknowledges.
    pub(super) fn acknowledge(&mut self, status: &Status) {
        (self.acked, self.credits) = (status.next_seq, status.credits.into());
        self.window.iter_mut().for_each(|batch| batch.acknowledge(status));
    }

    /// The frame of this number, if it was sent and has no verdict.
    pub(super) fn unjudged(&self, seq: u16) -> Option<&Batch> {
        let has_verdict = self.verdicts.iter().any(|report| judged(report) == Some(seq));
        self.window.iter().find(|batch| batch.seq() == seq && batch.is_sent()).filter(|_| !has_verdict)
    }

    /// Takes a verdict, the report of this number; `stale`: of an epoch that is over.
    pub(super) fn judge(&mut self, number: u16, report: Report, stale: bool) {
        match report {
            _ if stale => self.retired.judge(number, report),
            // The steps of an item's frame are judged one by one, and the streamer learns of a mark when it has passed.
            Report::OnsetRefused { seq, .. } if self.unjudged(seq).is_some_and(|frame| !frame.is_onset()) => {
            }
            _ => self.verdicts.push_back(report),
        }
    }

    /// Emits the verdicts of the frames before `next_seq`. All their reports are read: the device accepted every step that no
    /// report names. `tick` is the device's clock.
    pub(super) fn conclude(
        &mut self,
        next_seq: u16,
        tick: Tick,
        now: HostInstant,
        emit: &mut dyn FnMut(Event),
    ) {
        self.retired.conclude(tick, now, emit);
        let is_decided = |batch: &mut Batch| (1..=u16::MAX / 2).contains(&next_seq.wrapping_sub(batch.seq()));
        while let Some(batch) = self.window.pop_front_if(is_decided) {
            let report = self.verdicts.pop_front_if(|report| judged(report) == Some(batch.seq()));
            if let Some(Report::OnsetRefused { rendered, .. }) = report {
                emit(Event::OnsetRefused { rendered: rendered.near(tick) });
                continue;
            }
            if batch.is_onset() {
                self.kept = MotorSet::EMPTY;
                emit(Event::OnsetAccepted);
            }
            if let Some(motors) = batch.withdraws() {
                let kept = kept_motors(report);
                self.kept = self.kept.without(motors) | kept;
                emit(Event::Replaced { motors: motors.without(kept), kept });
            }
            batch
                .verdicts(report, self.kept, tick, now)
                .for_each(|(step, verdict)| emit(Event::Step(step, verdict)));
        }
    }
}
