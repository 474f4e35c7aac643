//! A frame of moves, from its first step to its verdicts.
//!
//! It packs steps, knows when it is to be sent, and reads the device's report about it. It does not know its neighbours: the
//! [`Outbox`](super::outbox::Outbox) says which frame is next.
//!
//! Invariant: a frame that was sent takes no more steps, so what the device judges is what the host keeps.

use crate::bandwidth::FRAME_BYTES;
use crate::link::session::event::Verdict;
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, MAX_BATCH, MAX_FIRST_BATCH, Packer};
use firmware_protocol::controller::REORDER_WINDOW;
use firmware_protocol::frame::{self, MAX_FRAME};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{HostMessage, Mark, MarkKind, Report, Status, Withdraw};
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Step;
use std::time::Duration;

/// Bytes of a step in a frame, usually; at most 21.
const STROKE_BYTES: usize = 8;

/// A frame of moves.
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
    /// To be sent, or sent again.
    due: bool,
    /// The device keeps it, but misses one before it.
    kept: bool,
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
    /// An empty frame; `withdraws`: it replaces queued moves, of these motors so far.
    pub(super) fn new(seq: u16, base: Tick, mark: Option<Mark>, withdraws: Option<MotorSet>) -> Self {
        Self {
            seq,
            mark,
            withdraws,
            packed: Packer::new(base),
            steps: heapless::Vec::new(),
            len: 0,
            first_sent: None,
            last_sent: HostInstant::default(),
            due: true,
            kept: false,
            retransmitted: false,
        }
    }

    pub(super) const fn seq(&self) -> u16 {
        self.seq
    }

    /// Whether it is the first frame of a play.
    pub(super) fn is_onset(&self) -> bool {
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

    pub(super) const fn is_sent(&self) -> bool {
        self.first_sent.is_some()
    }

    /// Its bytes that the device still has to receive, as far as they were sent.
    pub(super) const fn bytes_under_way(&self) -> usize {
        if self.kept { 0 } else { self.len }
    }

    /// Adds a step; `false` if it does not fit a frame of at most `longest` bytes.
    pub(super) fn push(&mut self, step: &Step, longest: usize) -> bool {
        let has_space = longest == MAX_FRAME
            || self.packed.count() == 0
            || FRAME_BYTES + self.packed.bytes().len() + STROKE_BYTES <= longest;
        // The device takes the first frame of a play in one piece.
        let is_first = self.is_onset() && self.packed.count() + step.moves() > MAX_FIRST_BATCH;
        // There is room: a step is a move or more.
        has_space && !is_first && step.pack(&mut self.packed).is_ok() && self.steps.push(*step).is_ok()
    }

    /// The same for a frame that is sealed: while it waits it takes more steps, unless it has a mark.
    pub(super) fn extend(&mut self, step: &Step, longest: usize) -> bool {
        !self.is_sent() && self.mark.is_none() && self.push(step, longest)
    }

    /// Withdraws what these motors have queued too; `false` if it replaces nothing.
    pub(super) fn withdraw(&mut self, motors: MotorSet) -> bool {
        let Some(withdraws) = &mut self.withdraws else { return false };
        *withdraws |= motors;
        true
    }

    /// Takes over whether the device keeps it.
    pub(super) fn acknowledge(&mut self, status: &Status) {
        let early = self.seq.wrapping_sub(status.next_seq).wrapping_sub(1);
        self.kept = usize::from(early) < REORDER_WINDOW && status.out_of_order >> early & 1 == 1;
    }

    /// Whether the device misses it, having acknowledged the frames before `acked`.
    pub(super) fn is_missing(&self, acked: u16) -> bool {
        !self.kept && self.seq.wrapping_sub(acked) <= u16::MAX / 2
    }

    /// Whether it is to be sent at `now`, again if the last time is `retry` ago.
    pub(super) fn is_due(&mut self, now: HostInstant, retry: Duration) -> bool {
        if !self.due && now.since(self.last_sent) >= retry {
            (self.due, self.retransmitted) = (true, true);
        }
        self.due
    }

    pub(super) const fn is_retransmitted(&self) -> bool {
        self.retransmitted
    }

    /// When it is to be sent next, if no answer comes.
    pub(super) fn due(&self, now: HostInstant, retry: Duration) -> HostInstant {
        if self.is_sent() { self.last_sent + retry } else { now }
    }

    /// Writes it into `out` and takes it for sent. The device has the amendments up to `generation` once it takes the frame.
    pub(super) fn write(&mut self, now: HostInstant, head: Head, generation: u16, out: &mut [u8]) -> Written {
        let Head { epoch, seen } = head;
        let (seq, mark, base) = (self.seq, self.mark, self.packed.base().wire());
        let withdraw = self.withdraws.map(|motors| Withdraw { motors, generation });
        let batch = self.packed.bytes();
        let message = HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch };
        self.len = encoded(&message, out);
        let marks = self.marks().filter(|_| !self.is_sent());
        self.first_sent.get_or_insert(now);
        (self.last_sent, self.due) = (now, false);
        Written { len: self.len, retransmitted: self.retransmitted, marks }
    }

    /// Its steps with their verdicts, by the device's report if there is one. The device took no step of the motors `kept`.
    pub(super) fn verdicts(
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

/// The frame that a report judges.
pub(super) const fn judged(report: &Report) -> Option<u16> {
    match *report {
        Report::Verdict { seq, .. } | Report::OnsetRefused { seq, .. } => Some(seq),
        _ => None,
    }
}

/// The motors of which the device withdrew nothing, by its report if there is one.
pub(super) const fn kept_motors(report: Option<Report>) -> MotorSet {
    match report {
        Some(Report::Verdict { kept, .. }) => kept,
        _ => MotorSet::EMPTY,
    }
}

pub(super) fn encoded(message: &HostMessage<'_>, out: &mut [u8]) -> usize {
    // Every message fits a frame: batches are bounded by `BATCH_BYTES`.
    frame::encode(message, out).unwrap_or(0)
}
