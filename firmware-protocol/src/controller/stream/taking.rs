//! The part of the newest frame that is read and not taken yet: its moves or amendments.
//!
//! Taking a long frame whole would leave the chip little time to render lines. So the controller takes it in pieces
//! ([`Stream::take`]).
//!
//! Invariant: a play's first frame is judged and taken in one piece, so that it is taken whole or not at all.

use crate::array::MotorSet;
use crate::batch::{Amendments, BATCH_BYTES, Batch, MAX_BATCH, MAX_FIRST_BATCH, Malformed, Place, unpack};
use crate::controller::stream::{Parts, Stream};
use crate::limits::Refusal;
use crate::message::{Mark, MarkKind, Report, Withdraw};
use crate::moves::Move;
use crate::tick::Tick;
use core::task::{Poll, ready};

/// Most moves unpacked at a time, besides those of the last item.
const UNPACKED: usize = MAX_FIRST_BATCH / 2;
/// Most moves taken at a time, and one more if the last is half of a stroke.
const MOVES: usize = 10;
/// The same for a frame that withdraws, because each move may search the queue of a motor.
const REPLACING: usize = 6;
/// Most amendments taken at a time: each searches the queue of its motor.
const AMENDMENTS: usize = 4;
/// Most queued moves that searches pass at a time. A search that is not over goes on in the next piece.
const SEARCHED: u16 = 128;

/// The head of the next frame of the ordered stream.
#[derive(Clone, Copy, Debug)]
pub(in crate::controller) struct Next {
    pub(in crate::controller) seq: u16,
    pub(in crate::controller) mark: Option<Mark>,
    pub(in crate::controller) withdraw: Option<Withdraw>,
    pub(in crate::controller) base: Tick,
}

/// A frame of the ordered stream whose moves are being unpacked.
#[derive(Clone, Copy, Debug)]
pub(super) struct Packed {
    pub(super) head: Next,
    /// Its epoch and the reports that the host has seen, unless it was buffered.
    pub(super) received: Option<(u16, u16)>,
    place: Place,
}

#[derive(Clone, Debug)]
pub(super) struct Taking {
    /// The epoch in which the frame was read. A command may begin another before all is taken.
    epoch: u16,
    /// The packed moves or amendments of the frame.
    items: heapless::Vec<u8, BATCH_BYTES>,
    /// The frame whose moves are being unpacked.
    packed: Option<Packed>,
    /// The frame whose moves are to be taken; its mark is not.
    pub(super) next: Option<Next>,
    /// Unpacked in place, because a copy takes long.
    moves: Batch,
    /// The frame whose moves are being taken.
    seq: Option<u16>,
    /// Number of moves taken.
    taken: usize,
    /// Bits of the moves that were late, and refused.
    late: u64,
    /// When the first late one could have begun at the earliest.
    missed: Option<Tick>,
    refused: u64,
    /// Why the first of those was refused.
    reason: Option<Refusal>,
    /// The motors still to be withdrawn from, from which tick on, and the motors of which nothing was withdrawn.
    withdraw: MotorSet,
    from: Tick,
    kept: MotorSet,
    /// The amendments that are being taken: their generation, the bytes of them that are taken, and the tick from which the next
    /// one counts.
    amending: Option<(u16, usize, Tick)>,
}

impl Taking {
    pub(super) const NOTHING: Self = Self {
        epoch: 0,
        items: heapless::Vec::new(),
        packed: None,
        next: None,
        moves: Batch::new(),
        seq: None,
        taken: 0,
        late: 0,
        missed: None,
        refused: 0,
        reason: None,
        withdraw: MotorSet::EMPTY,
        from: Tick(0),
        kept: MotorSet::EMPTY,
        amending: None,
    };

    /// Keeps the amendments of a message.
    pub(super) fn amend(&mut self, epoch: u16, generation: u16, base: Tick, items: &[u8]) {
        self.epoch = epoch;
        self.keep_items(items);
        self.amending = Some((generation, 0, base));
    }

    /// Keeps the packed moves of a frame.
    pub(super) fn begin(
        &mut self,
        epoch: u16,
        head: Next,
        received: Option<(u16, u16)>,
        batch: &[u8],
    ) -> Packed {
        self.epoch = epoch;
        self.keep_items(batch);
        self.moves.clear();
        Packed { head, received, place: Place::new(head.base) }
    }

    /// Unpacks a piece. `None`: some are left.
    pub(super) fn unpack_piece(&mut self, mut packed: Packed) -> Result<Option<Packed>, Malformed> {
        if unpack(&self.items, &mut packed.place, &mut self.moves, UNPACKED)? {
            return Ok(Some(packed));
        }
        self.packed = Some(packed);
        Ok(None)
    }

    /// The packed moves or amendments.
    pub(super) fn items(&self) -> &[u8] {
        &self.items
    }

    fn keep_items(&mut self, items: &[u8]) {
        self.items.clear();
        // No message has room for more bytes.
        let _ = self.items.extend_from_slice(items);
    }
}

impl Stream {
    /// Takes a piece of the frame that was received last. Returns `false` if nothing is left of it.
    pub(in crate::controller) fn take(&mut self, parts: &mut Parts<'_>) -> bool {
        // An e-stop may have begun an epoch since, ahead of the bytes before it.
        if self.taking.epoch != parts.session.epoch() {
            (self.taking.packed, self.taking.next, self.taking.seq) = (None, None, None);
            self.taking.amending = None;
        }
        if let Some(packed) = self.taking.packed.take() {
            self.unpack(packed, parts);
            return true;
        }
        if let Some(next) = self.taking.next.take() {
            self.take_head(next, parts);
            return true;
        }
        if let Some(seq) = self.taking.seq {
            let replaces = !self.taking.withdraw.is_empty();
            self.take_moves(seq, if replaces { REPLACING } else { MOVES }, parts);
            return true;
        }
        self.take_amendments(parts)
    }

    /// Takes the head of the next frame of the ordered stream.
    fn take_head(&mut self, Next { seq, mark, withdraw, base }: Next, parts: &mut Parts<'_>) {
        self.next_seq = seq.wrapping_add(1);
        // The frame may have been repeated before its buffered copy was taken.
        let _ = self.reorder.take(seq);
        if let Some(mark) = mark
            && parts.armed
        {
            // No move begins before the base.
            let ready = parts.player.ready();
            let begins_play = mark.kind == MarkKind::Play;
            // The first frame of a play is taken in one piece, and lines must be rendered in time.
            let fits = !begins_play || self.taking.moves.len() <= MAX_FIRST_BATCH;
            if base >= ready && fits {
                parts.player.push_mark(base, &mark, begins_play);
            } else {
                parts.reporting.report(Report::OnsetRefused { seq, rendered: ready.wire() });
                if begins_play {
                    return;
                }
            }
            if begins_play {
                self.kept = MotorSet::EMPTY;
            }
        }
        let taking = &mut self.taking;
        (taking.seq, taking.taken) = (Some(seq), 0);
        (taking.late, taking.missed, taking.refused, taking.reason) = (0, None, 0, None);
        (taking.withdraw, taking.from, taking.kept) = (MotorSet::EMPTY, base, MotorSet::EMPTY);
        // Between pieces lines are rendered, and a move that was in time may become late.
        let begins_play = mark.is_some_and(|mark| mark.kind == MarkKind::Play);
        if let Some(withdraw) = withdraw
            && !begins_play
        {
            taking.withdraw = withdraw.motors & parts.player.layout().all();
            self.note_generation(withdraw.generation);
        }
        let len = self.taking.moves.len();
        let is_short = len <= MOVES || (len <= MAX_FIRST_BATCH && parts.player.is_empty());
        if begins_play || (is_short && self.taking.withdraw.is_empty()) {
            self.take_moves(seq, MAX_BATCH, parts);
        }
    }

    /// Takes at most `most` moves. Each is counted at once, because an e-stop may end the frame between two pieces. A motor's moves are
    /// withdrawn in the moment in which the first move that replaces them is queued.
    fn take_moves(&mut self, seq: u16, most: usize, parts: &mut Parts<'_>) {
        let (mut steps, mut done) = (SEARCHED, 0);
        while done < most {
            let at = self.taking.taken;
            let Some(first) = self.taking.moves.get(at) else {
                // What is left to withdraw is replaced by nothing.
                let Some(motor) = self.taking.withdraw.lowest() else { break };
                if self.take_withdrawal(motor, &[], &mut steps, parts).is_pending() {
                    return;
                }
                done += 1;
                continue;
            };
            let first = first.of;
            // The two moves of a stroke are taken or left together.
            let both = self.taking.moves.get(at + 1).filter(|next| next.joined).map(|next| [first, next.of]);
            let moves = both.as_ref().map_or(core::slice::from_ref(&first), |both| both.as_slice());
            if self.taking.withdraw.contains(first.motor)
                && self.take_withdrawal(first.motor, moves, &mut steps, parts).is_pending()
            {
                return;
            }
            let count = moves.len();
            // A shift of 64 bits is a function call on the chip.
            let bits = || ((1_u64 << count) - 1) << at;
            match self.accept(moves, parts) {
                Ok(true) => {}
                Ok(false) => {
                    let is_kept = self.kept.contains(first.motor);
                    // The old moves are played in its place.
                    *(if is_kept {
                        &mut parts.reporting.count().replaced
                    } else {
                        &mut parts.reporting.count().late
                    }) += count as u64;
                    if !is_kept && count == 1 {
                        parts.player.late(&first);
                    }
                    self.taking.late |= bits();
                    let ready = parts.player.ready();
                    self.taking.missed.get_or_insert(ready);
                }
                Err(refusal) => {
                    parts.reporting.count().refused += count as u64;
                    self.taking.refused |= bits();
                    self.taking.reason = self.taking.reason.or(Some(refusal));
                }
            }
            self.taking.taken += count;
            done += count;
        }
        if self.taking.taken < self.taking.moves.len() || !self.taking.withdraw.is_empty() {
            return;
        }
        let &Taking { late, missed, refused, reason, kept, .. } = &self.taking;
        self.taking.seq = None;
        if late | refused != 0 || !kept.is_empty() {
            let rendered = missed.unwrap_or(parts.player.rendered()).wire();
            parts.reporting.report(Report::Verdict { seq, late, refused, kept, reason, rendered });
        }
    }

    /// Withdraws from one motor what `next`, a move or stroke, replaces. Pending: as in [`Self::withdraw`].
    fn take_withdrawal(
        &mut self,
        motor: u8,
        next: &[Move],
        steps: &mut u16,
        parts: &mut Parts<'_>,
    ) -> Poll<()> {
        let withdrawn = ready!(self.withdraw(motor, self.taking.from, next, steps, parts));
        self.taking.withdraw.remove(motor);
        if !withdrawn {
            self.taking.kept.insert(motor);
            let ready = parts.player.ready();
            self.taking.missed.get_or_insert(ready);
        }
        Poll::Ready(())
    }

    fn take_amendments(&mut self, parts: &mut Parts<'_>) -> bool {
        let Some((generation, mut read, mut at)) = self.taking.amending.take() else { return false };
        let mut steps = SEARCHED;
        for _ in 0..AMENDMENTS {
            let items = &self.taking.items;
            let mut left = Amendments::new(at, items.get(read..).unwrap_or_default());
            let Some(item) = left.next() else { return true };
            let next = (items.len() - left.rest().len(), left.at());
            self.note_generation(generation);
            let amended = match item {
                Ok(item) if parts.armed => parts.player.amend(generation, &item, &mut steps),
                _ => Poll::Ready(false),
            };
            let Poll::Ready(amended) = amended else { break };
            (read, at) = next;
            parts.reporting.count().amendments_ignored += u64::from(!amended);
        }
        self.taking.amending = Some((generation, read, at));
        true
    }
}
