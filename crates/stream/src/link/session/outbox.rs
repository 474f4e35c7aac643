//! The strokes on their way: frames that are filled, sent, sent again, and judged; and the amendments.
//!
//! The device takes the next frame in order and no other. So after a gap, and when no acknowledgement
//! comes, the outbox sends all frames again from the first one that is not acknowledged (go-back-N).
//! The session says what the device has acknowledged and which reports it has read; the outbox says
//! which frame is to be sent, and emits the verdicts. It knows no commands: [`Outbox::begin_epoch`]
//! ends all that is under way.
//!
//! Invariant: frames are judged in the order of their numbers, each once. One that was sent takes no
//! more steps, so what the device judges is what the host keeps. There are at most [`WINDOW`], and
//! never more strokes in them than the device has credits.

use crate::link::session::event::{Event, Verdict};
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{Amendment, BATCH_BYTES, MAX_BATCH, MAX_FIRST_BATCH, Packer};
use firmware_protocol::controller::REPORTS;
use firmware_protocol::frame::{self, MAX_FRAME};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{HostMessage, Mark, MarkKind, Report, Status, Withdraw};
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Step;
use std::collections::VecDeque;
use std::time::Duration;

/// Frames without a verdict at most.
const WINDOW: usize = 9;
/// Most bytes of a frame besides its moves.
const HEADER: usize = MAX_FRAME - BATCH_BYTES;

/// A frame of moves, from its first step to its verdicts.
#[derive(Clone, Debug)]
pub(super) struct Batch {
    seq: u16,
    mark: Option<Mark>,
    /// The motors from which it withdraws what begins at its base or later.
    withdraws: Option<MotorSet>,
    packed: Packer<BATCH_BYTES>,
    /// What is packed, in order.
    steps: heapless::Vec<Step, MAX_BATCH>,
    /// Its bytes on the wire, once sent.
    len: usize,
    first_sent: Option<HostInstant>,
    last_sent: HostInstant,
    retransmitted: bool,
}

/// What a frame says of its session, besides its moves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    pub(super) epoch: u16,
    /// The last report that the host has read.
    pub(super) seen: u16,
}

/// A frame that was written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Written {
    pub(super) len: usize,
    pub(super) retransmitted: bool,
    /// The onset that it marks, when it is sent for the first time.
    pub(super) marks: Option<Tick>,
}

impl Batch {
    fn new(seq: u16, base: Tick, mark: Option<Mark>, withdraws: Option<MotorSet>) -> Self {
        Self {
            seq,
            mark,
            withdraws,
            packed: Packer::new(base),
            steps: heapless::Vec::new(),
            len: 0,
            first_sent: None,
            last_sent: HostInstant::default(),
            retransmitted: false,
        }
    }

    /// Whether it is the first frame of a play.
    fn is_onset(&self) -> bool {
        self.mark.is_some_and(|mark| mark.kind == MarkKind::Play)
    }

    /// The onset that it marks.
    pub(super) fn marks(&self) -> Option<Tick> {
        self.mark.map(|_| self.packed.base())
    }

    pub(super) const fn withdraws(&self) -> Option<MotorSet> {
        self.withdraws
    }

    /// Number of its moves.
    pub(super) fn moves(&self) -> usize {
        self.packed.count()
    }

    /// Adds a step; `false` if it does not fit.
    fn push(&mut self, step: &Step) -> bool {
        // The device takes the first frame of a play in one piece.
        let is_first = self.is_onset() && self.packed.count() + step.moves() > MAX_FIRST_BATCH;
        // There is room: a step is a move or more.
        !is_first && step.pack(&mut self.packed).is_ok() && self.steps.push(*step).is_ok()
    }

    /// Writes it into `out` and takes it for sent. The device has the amendments up to `generation` once
    /// it takes the frame.
    fn write(&mut self, now: HostInstant, head: Head, generation: u16, out: &mut [u8]) -> Written {
        let Head { epoch, seen } = head;
        let (seq, mark, base) = (self.seq, self.mark, self.packed.base().wire());
        let withdraw = self.withdraws.map(|motors| Withdraw { motors, generation });
        let batch = self.packed.bytes();
        self.len = encoded(&HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch }, out);
        self.retransmitted = self.first_sent.is_some();
        let marks = self.marks().filter(|_| !self.retransmitted);
        self.first_sent.get_or_insert(now);
        self.last_sent = now;
        Written { len: self.len, retransmitted: self.retransmitted, marks }
    }

    /// Its steps with their verdicts, by the device's report if there is one. The device took no step of
    /// the motors `kept`.
    fn verdicts(
        &self,
        report: Option<Report>,
        kept: MotorSet,
        tick: Tick,
        now: HostInstant,
    ) -> impl Iterator<Item = (Step, Verdict)> {
        let (late, refused, why, free) = match report {
            Some(Report::Verdict { late, refused, reason, rendered, .. }) => {
                (late, refused, reason.unwrap_or(Refusal::Malformed), rendered.near(tick))
            }
            _ => (0, 0, Refusal::Malformed, tick),
        };
        let sent = self.first_sent.unwrap_or(now);
        let mut place = 0;
        self.steps.iter().map(move |step| {
            // Both moves of a stroke have one verdict.
            let i = place;
            place += step.moves();
            let verdict = if late >> i & 1 == 1 && kept.contains(step.motor()) {
                Verdict::Superseded
            } else if late >> i & 1 == 1 {
                Verdict::Late { rendered: free, sent, retransmitted: self.retransmitted }
            } else if refused >> i & 1 == 1 {
                Verdict::Refused(why)
            } else {
                Verdict::Accepted
            };
            (*step, verdict)
        })
    }
}

/// The frames of an epoch that have no verdict.
#[derive(Clone, Debug)]
struct Unjudged {
    frames: VecDeque<Batch>,
    /// The motors whose old strokes the device keeps: it takes no others until it is asked to withdraw
    /// again.
    kept: MotorSet,
    /// Verdicts that are read and not emitted.
    verdicts: VecDeque<Report>,
}

impl Unjudged {
    fn new() -> Self {
        let (frames, verdicts) = (VecDeque::with_capacity(WINDOW + 1), VecDeque::with_capacity(REPORTS));
        Self { frames, kept: MotorSet::EMPTY, verdicts }
    }

    /// The device took a frame that withdraws, all but what it reports.
    fn keep(&mut self, batch: &Batch, report: Option<Report>) -> Option<Event> {
        let motors = batch.withdraws?;
        let kept = match report {
            Some(Report::Verdict { kept, .. }) => kept,
            _ => MotorSet::EMPTY,
        };
        self.kept = self.kept.without(motors) | kept;
        Some(Event::Replaced { motors: motors.without(kept), kept })
    }
}

/// The frames of the present epoch, and those that the last command ended.
#[derive(Clone, Debug)]
pub(super) struct Outbox {
    window: Unjudged,
    open: Option<Batch>,
    /// A replacement that is not in frames yet: from which tick on, and the motors.
    replacing: Option<(Tick, MotorSet)>,
    next_seq: u16,
    /// The device acknowledged all frames before this one.
    acked: u16,
    /// The frame to be sent next, perhaps again: those from `acked` to this one are under way.
    cursor: u16,
    /// The device's free stroke slots, after the frames before `acked`.
    credits: usize,
    amendments: Packer<BATCH_BYTES>,
    generation: u16,
    /// The frames that had no verdict when a command ended their epoch; reports up to this one are about
    /// earlier epochs. The device may have refused strokes before it read the command. What no report
    /// names was taken, or not played because of the command: nothing is emitted of it.
    retired: Unjudged,
    retired_after: u16,
}

impl Outbox {
    pub(super) fn new() -> Self {
        Self {
            window: Unjudged::new(),
            open: None,
            replacing: None,
            next_seq: 0,
            acked: 0,
            cursor: 0,
            credits: 0,
            amendments: Packer::new(Tick(0)),
            generation: 0,
            retired: Unjudged::new(),
            retired_after: 0,
        }
    }

    /// A new epoch: nothing of the old one is sent any more. `retires`: its frames may still be judged,
    /// by reports after this one.
    pub(super) fn begin_epoch(&mut self, retires: Option<u16>) {
        if let Some(after) = retires {
            std::mem::swap(&mut self.window, &mut self.retired);
            self.retired_after = after;
        }
        self.drop_frames();
        self.window.verdicts.clear();
        self.window.kept = MotorSet::EMPTY;
        (self.next_seq, self.acked, self.cursor, self.generation) = (0, 0, 0, 0);
        self.amendments = Packer::new(Tick(0));
    }

    /// Sends no frame any more.
    pub(super) fn drop_frames(&mut self) {
        self.window.frames.clear();
        (self.open, self.replacing) = (None, None);
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
        let under_way: usize = self.window.frames.iter().chain(&self.open).map(Batch::moves).sum();
        self.credits.saturating_sub(under_way)
    }

    /// Whether a frame may be begun: the window has room, and no onset waits for its verdict.
    pub(super) fn has_room(&self) -> bool {
        let frames = &self.window.frames;
        frames.len() < WINDOW && !frames.back().is_some_and(Batch::is_onset)
    }

    /// Takes a step; `false` if it must wait for credits, the window or an onset's verdict.
    pub(super) fn push(&mut self, step: &Step) -> bool {
        if !self.has_room() || self.credits() < step.moves() {
            return false;
        }
        if let Some(batch) = &mut self.open {
            if !batch.push(step) {
                self.seal();
                return self.push(step);
            }
            let mut bit = MotorSet::EMPTY;
            bit.insert(step.motor());
            // The first step of a motor takes the place of its old ones.
            if let (Some((from, motors)), Some(withdraws)) = (self.replacing, &mut batch.withdraws) {
                *withdraws |= bit & motors;
                self.replacing = Some((from, motors.without(bit))).filter(|(_, motors)| !motors.is_empty());
            }
            return true;
        }
        if let Some((from, _)) = self.replacing {
            self.open = Some(Batch::new(self.next_seq, from, None, Some(MotorSet::EMPTY)));
            return self.push(step);
        }
        // A frame that waits takes more steps, unless it has a mark: on a link with slow answers frames
        // get longer, not more.
        let last = self.window.frames.back_mut();
        if last.is_some_and(|last| last.first_sent.is_none() && last.mark.is_none() && last.push(step)) {
            return true;
        }
        self.open.insert(Batch::new(self.next_seq, step.begin(), None, None)).push(step)
    }

    /// Ends the open frame, so that it can be sent.
    pub(super) fn seal(&mut self) {
        if let Some(batch) = self.open.take() {
            self.next_seq = self.next_seq.wrapping_add(1);
            self.window.frames.push_back(batch);
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

    /// The place of a frame in the window.
    fn place(&self, seq: u16) -> usize {
        self.window.frames.front().map_or(0, |first| seq.wrapping_sub(first.seq)).into()
    }

    /// The first frame that is not acknowledged, if it is under way.
    fn first_under_way(&self) -> Option<&Batch> {
        self.window.frames.get(self.place(self.acked)).filter(|_| self.cursor != self.acked)
    }

    /// Sends all that is not acknowledged again if the first of it was sent so long ago.
    fn go_back(&mut self, now: HostInstant, after: Duration) {
        if self.first_under_way().is_some_and(|first| now.since(first.last_sent) >= after) {
            self.cursor = self.acked;
        }
    }

    /// Writes the next frame, while at most `window_bytes` are under way. After `retry` without an
    /// acknowledgement it begins again.
    pub(super) fn write_next(
        &mut self,
        now: HostInstant,
        head: Head,
        retry: Duration,
        window_bytes: usize,
        out: &mut [u8],
    ) -> Option<Written> {
        self.go_back(now, retry);
        let (place, under_way) = (self.place(self.cursor), self.bytes_under_way());
        let next = self.window.frames.get_mut(place)?;
        if under_way > 0 && under_way + HEADER + next.packed.bytes().len() > window_bytes {
            return None;
        }
        self.cursor = self.cursor.wrapping_add(1);
        // No amendment of a stroke of this frame is sent before its verdict, so the amendments up to now
        // concern old strokes.
        Some(next.write(now, head, self.generation, out))
    }

    /// When [`Self::write_next`] may have a frame, if no answer comes.
    pub(super) fn due(&self, now: HostInstant, retry: Duration) -> Option<HostInstant> {
        match self.first_under_way() {
            Some(first) => Some(first.last_sent + retry),
            None => self.window.frames.get(self.place(self.cursor)).map(|_| now),
        }
    }

    /// Bytes that are sent and not with the device, as far as it has said.
    pub(super) fn bytes_under_way(&self) -> usize {
        let frames = self.cursor.wrapping_sub(self.acked).into();
        self.window.frames.iter().skip(self.place(self.acked)).take(frames).map(|batch| batch.len).sum()
    }

    /// The device acknowledged all frames before this one.
    pub(super) const fn acked(&self) -> u16 {
        self.acked
    }

    /// Frames from [`Self::acked`] on that were sent.
    pub(super) fn unacknowledged(&self) -> usize {
        let last = self.window.frames.iter().rev().find(|batch| batch.first_sent.is_some());
        last.map_or(0, |last| last.seq.wrapping_add(1).wrapping_sub(self.acked).into())
    }

    /// Takes over what a status of this epoch acknowledges. After a gap it begins again, unless that was
    /// less than a round trip ago.
    pub(super) fn acknowledge(&mut self, status: &Status, now: HostInstant, round_trip: Duration) {
        (self.acked, self.credits) = (status.next_seq, status.credits.into());
        if self.acked.wrapping_sub(self.cursor) <= u16::MAX / 2 {
            self.cursor = self.acked;
        }
        if status.gap {
            self.go_back(now, round_trip);
        }
    }

    /// The frame of this number, if it was sent and has no verdict.
    pub(super) fn unjudged(&self, seq: u16) -> Option<&Batch> {
        let has_verdict = self.window.verdicts.iter().any(|report| judged(report) == Some(seq));
        let mut frames = self.window.frames.iter();
        frames.find(|batch| batch.seq == seq && batch.first_sent.is_some()).filter(|_| !has_verdict)
    }

    /// Takes a verdict, the report of this number; `stale`: of an epoch that is over.
    pub(super) fn judge(&mut self, number: u16, report: Report, stale: bool) {
        match report {
            _ if stale => {
                let is_later = (1..=u16::MAX / 2).contains(&number.wrapping_sub(self.retired_after));
                if is_later && self.retired.verdicts.len() < REPORTS {
                    self.retired.verdicts.push_back(report);
                }
            }
            // The steps of an item's frame are judged one by one, and the streamer learns of a mark when it
            // has passed.
            Report::OnsetRefused { seq, .. } if self.unjudged(seq).is_some_and(|frame| !frame.is_onset()) => {
            }
            _ => self.window.verdicts.push_back(report),
        }
    }

    /// Emits the verdicts of the frames before `next_seq`. All their reports are read: the device accepted
    /// every step that no report names. `tick` is the device's clock.
    pub(super) fn conclude(
        &mut self,
        next_seq: u16,
        tick: Tick,
        now: HostInstant,
        emit: &mut dyn FnMut(Event),
    ) {
        self.conclude_retired(tick, now, emit);
        let window = &mut self.window;
        let is_decided = |batch: &mut Batch| (1..=u16::MAX / 2).contains(&next_seq.wrapping_sub(batch.seq));
        while let Some(batch) = window.frames.pop_front_if(is_decided) {
            let report = window.verdicts.pop_front_if(|report| judged(report) == Some(batch.seq));
            if let Some(Report::OnsetRefused { rendered, .. }) = report {
                emit(Event::OnsetRefused { rendered: rendered.near(tick) });
                continue;
            }
            if batch.is_onset() {
                window.kept = MotorSet::EMPTY;
                emit(Event::OnsetAccepted);
            }
            window.keep(&batch, report).into_iter().for_each(&mut *emit);
            batch
                .verdicts(report, window.kept, tick, now)
                .for_each(|(step, verdict)| emit(Event::Step(step, verdict)));
        }
    }

    /// Emits the verdicts late and refused of the epoch that was ended.
    fn conclude_retired(&mut self, tick: Tick, now: HostInstant, emit: &mut dyn FnMut(Event)) {
        let retired = &mut self.retired;
        while let Some(report) = retired.verdicts.pop_front() {
            let Report::Verdict { seq, .. } = report else { continue };
            if !retired.frames.iter().any(|batch| batch.seq == seq) {
                continue;
            }
            // Frames before it without a report were taken as sent.
            while let Some(before) = retired.frames.pop_front_if(|batch| batch.seq != seq) {
                retired.keep(&before, None);
            }
            let Some(batch) = retired.frames.pop_front() else { continue };
            retired.keep(&batch, Some(report));
            batch
                .verdicts(Some(report), retired.kept, tick, now)
                .filter(|(_, verdict)| *verdict != Verdict::Accepted)
                .for_each(|(step, verdict)| emit(Event::Step(step, verdict)));
        }
    }
}

/// The frame that a report judges.
pub(super) const fn judged(report: &Report) -> Option<u16> {
    match *report {
        Report::Verdict { seq, .. } | Report::OnsetRefused { seq, .. } => Some(seq),
        _ => None,
    }
}

pub(super) fn encoded(message: &HostMessage<'_>, out: &mut [u8]) -> usize {
    // Every message fits a frame: batches are bounded by `BATCH_BYTES`.
    frame::encode(message, out).unwrap_or(0)
}

#[cfg(test)]
mod tests;
