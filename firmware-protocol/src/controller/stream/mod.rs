//! Takes the ordered stream: frames of moves in the order of their numbers, and amendments.
//!
//! A frame is unpacked, then its head is taken, then its moves ([`Stream::take`]), a piece at a time. Frames that arrive out of order
//! wait in `reorder`; `taking` holds the frame that is being taken.
//!
//! Invariant: each frame of an epoch is taken once, after all frames before it. No move of a motor in `kept` is queued.

mod reorder;
mod taking;

use crate::array::MotorSet;
use crate::batch::Malformed;
use crate::controller::newer;
use crate::controller::player::Player;
use crate::controller::reporting::{RESERVE, Reporting};
use crate::controller::session::Session;
use crate::limits::Refusal;
use crate::moves::Move;
use crate::tick::Tick;
use core::task::{Poll, ready};
pub use reorder::REORDER_WINDOW;
use reorder::ReorderBuffer;
pub(super) use taking::Next;
use taking::{Packed, Taking};

#[derive(Clone, Debug)]
pub(super) struct Stream {
    next_seq: u16,
    /// Motors whose moves are late until a frame withdraws again from them, because it came too late the last time.
    kept: MotorSet,
    /// The newest amendment of this epoch that the device knows of.
    generation: Option<u16>,
    taking: Taking,
    reorder: ReorderBuffer,
}

/// The parts of the controller that the stream works on, and when it does.
pub(super) struct Parts<'a> {
    pub(super) now: Tick,
    pub(super) armed: bool,
    pub(super) player: &'a mut Player,
    pub(super) reporting: &'a mut Reporting,
    pub(super) session: &'a mut Session,
}

impl Stream {
    pub(super) const NOTHING: Self = Self {
        next_seq: 0,
        kept: MotorSet::EMPTY,
        generation: None,
        taking: Taking::NOTHING,
        reorder: ReorderBuffer::new(),
    };

    /// The stream begins again, with an epoch.
    pub(super) fn begin(&mut self) {
        self.next_seq = 0;
        self.reorder.clear();
        (self.kept, self.generation) = (MotorSet::EMPTY, None);
    }

    /// The number of the next frame in order.
    pub(super) fn next_seq(&self) -> u16 {
        self.next_seq
    }

    /// Bit i: the frame `i + 1` after the next one is buffered.
    pub(super) fn out_of_order(&self) -> u8 {
        self.reorder.mask(self.next_seq)
    }

    /// Begins to take the amendments of a message of this epoch.
    pub(super) fn receive_amendments(&mut self, epoch: u16, generation: u16, base: Tick, items: &[u8]) {
        self.taking.amend(epoch, generation, base, items);
    }

    /// Unpacks the first piece of a frame. `received` has its epoch and the reports that the host has seen, unless the frame was
    /// buffered.
    pub(super) fn receive(
        &mut self,
        head: Next,
        received: Option<(u16, u16)>,
        batch: &[u8],
        parts: &mut Parts<'_>,
    ) {
        let packed = self.taking.begin(parts.session.epoch(), head, received, batch);
        self.unpack(packed, parts);
    }

    /// Unpacks a piece of a frame. One that cannot be read to its end changes nothing.
    fn unpack(&mut self, packed: Packed, parts: &mut Parts<'_>) {
        match self.taking.unpack_piece(packed) {
            Ok(None) => {}
            Ok(Some(Packed { head, received: None, .. })) => self.taking.next = Some(head),
            Ok(Some(Packed { head, received: Some((epoch, seen)), .. })) => {
                parts.session.last_heard = parts.now;
                parts.reporting.pending.status = true;
                parts.reporting.seen(seen, parts.now);
                if epoch == parts.session.epoch() {
                    self.order(head, parts);
                }
            }
            Err(Malformed) => parts.reporting.count().bad_frames += 1,
        }
    }

    /// Prepares the frame that was unpacked if it is next in order. Else buffers it for [`Self::follow`].
    fn order(&mut self, head: Next, parts: &Parts<'_>) {
        if head.seq != self.next_seq {
            self.reorder.insert(self.next_seq, head, self.taking.items());
        } else if parts.has_room(&head) {
            self.taking.next = Some(head);
        }
    }

    /// Prepares one buffered frame if it is next in order.
    pub(super) fn follow(&mut self, parts: &mut Parts<'_>) -> bool {
        let Some(frame) = self.reorder.take(self.next_seq) else { return false };
        // Without room the frame is forgotten; the host sends it again.
        if parts.has_room(&frame.head) {
            parts.reporting.pending.status = true;
            self.receive(frame.head, None, &frame.batch, parts);
        }
        true
    }

    /// Queues a move, or the two of a stroke. `Ok(false)` if they are late.
    fn accept(&self, moves: &[Move], parts: &mut Parts<'_>) -> Result<bool, Refusal> {
        let mut late = false;
        for to in moves {
            late |= !parts.judge(to)?;
        }
        if late || moves.iter().any(|to| self.kept.contains(to.motor)) {
            return Ok(false);
        }
        parts.player.takes(moves, parts.reporting)?;
        parts.player.append(moves, self.generation, parts.reporting);
        Ok(true)
    }

    /// Withdraws the moves of `motor` from `from` on, if none of them has begun and `next`, the move or stroke that takes their place, can be
    /// queued. Otherwise all of them stay, and the motor's new moves are not taken until the next withdrawal. Returns whether it has
    /// withdrawn them. Pending: it has searched past as many moves as it may, `steps`; the next call goes on.
    fn withdraw(
        &mut self,
        motor: u8,
        from: Tick,
        next: &[Move],
        steps: &mut u16,
        parts: &mut Parts<'_>,
    ) -> Poll<bool> {
        let usable = parts.armed && next.iter().all(|to| parts.judge(to) == Ok(true));
        let withdrawn = if usable { ready!(parts.player.withdraw(motor, from, next, steps)) } else { None };
        let Some(moves) = withdrawn else {
            self.kept.insert(motor);
            return Poll::Ready(false);
        };
        self.kept.remove(motor);
        parts.reporting.count().replaced += u64::from(moves);
        Poll::Ready(true)
    }

    /// The host has made an amendment of this generation.
    fn note_generation(&mut self, generation: u16) {
        if self.generation.is_none_or(|old| newer(generation, old)) {
            self.generation = Some(generation);
        }
    }
}

impl Parts<'_> {
    /// Whether there is room for a frame's reports and its mark.
    fn has_room(&self, head: &Next) -> bool {
        let reports = RESERVE + usize::from(head.mark.is_some());
        self.reporting.reports().free() > reports && (head.mark.is_none() || self.player.takes_mark())
    }

    /// Judges a move by itself. `Ok(false)` if it is late.
    fn judge(&self, to: &Move) -> Result<bool, Refusal> {
        if !self.armed {
            return Err(Refusal::NotArmed);
        }
        self.player.judge(to, self.now)
    }
}
