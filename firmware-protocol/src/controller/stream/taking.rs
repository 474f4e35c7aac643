//! The part of the newest frame that is read and not taken yet: its moves or amendments.
//!
//! `take` takes it.

use crate::array::MotorSet;
use crate::batch::{BATCH_BYTES, Batch, MAX_FIRST_BATCH, Malformed, Place, unpack};
use crate::limits::Refusal;
use crate::message::{Mark, Withdraw};
use crate::tick::Tick;
use core::hash::{Hash, Hasher};

/// Most moves unpacked at a time, besides those of the last item.
const UNPACKED: usize = MAX_FIRST_BATCH / 2;

/// The head of the next frame of the ordered stream.
#[derive(Clone, Copy, Debug, Hash)]
pub(in crate::controller) struct Next {
    pub(in crate::controller) seq: u16,
    pub(in crate::controller) mark: Option<Mark>,
    pub(in crate::controller) withdraw: Option<Withdraw>,
    pub(in crate::controller) base: Tick,
}

/// A frame of the ordered stream whose moves are being unpacked.
#[derive(Clone, Copy, Debug, Hash)]
pub(super) struct Packed {
    pub(super) head: Next,
    /// Its epoch and the reports that the host has seen, unless it was buffered.
    pub(super) received: Option<(u16, u16)>,
    place: Place,
}

#[derive(Clone, Debug)]
pub(super) struct Taking {
    /// The epoch in which the frame was read. A command may begin another before all is taken.
    pub(super) epoch: u16,
    /// The packed moves or amendments of the frame.
    pub(super) items: heapless::Vec<u8, BATCH_BYTES>,
    /// The frame whose moves are being unpacked.
    pub(super) packed: Option<Packed>,
    /// The frame whose moves are to be taken; its mark is not.
    pub(super) next: Option<Next>,
    /// Unpacked in place, because a copy takes long.
    pub(super) moves: Batch,
    /// The frame whose moves are being taken.
    pub(super) seq: Option<u16>,
    /// Number of moves taken.
    pub(super) taken: usize,
    /// Bits of the moves that were late, and refused.
    pub(super) late: u64,
    /// When the first late one could have begun at the earliest.
    pub(super) missed: Option<Tick>,
    pub(super) refused: u64,
    /// Why the first of those was refused.
    pub(super) reason: Option<Refusal>,
    /// The motors still to be withdrawn from, from which tick on, and the motors of which nothing was withdrawn.
    pub(super) withdraw: MotorSet,
    pub(super) from: Tick,
    pub(super) kept: MotorSet,
    /// The amendments that are being taken: their generation, the bytes of them that are taken, and the tick from which the next
    /// one counts.
    pub(super) amending: Option<(u16, usize, Tick)>,
}

impl Hash for Taking {
    /// Leaves out what is taken: once nothing of a frame is left, its moves are not read again.
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let Self {
            epoch,
            items,
            packed,
            next,
            moves,
            seq,
            taken,
            late,
            missed,
            refused,
            reason,
            withdraw,
            from,
            kept,
            amending,
        } = self;
        if packed.is_some() {
            (epoch, items, packed, moves).hash(hasher);
        }
        if next.is_some() || seq.is_some() {
            (epoch, next, moves, seq, taken).hash(hasher);
            (late, missed, refused, reason, withdraw, from, kept).hash(hasher);
        }
        if let Some((generation, amended, at)) = amending
            && let Some(left @ [_, ..]) = items.get(*amended..)
        {
            (epoch, left, generation, at).hash(hasher);
        }
    }
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
