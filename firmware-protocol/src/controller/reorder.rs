//! Frames of the ordered stream that came before their turn: kept, so that a lost frame costs one round trip.

use crate::batch::BATCH_BYTES;
use crate::tick::Tick;

/// Frames kept at the most: those that follow the one waited for.
pub const REORDER_WINDOW: usize = 8;

/// A frame of strokes, as it came.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) seq: u16,
    pub(super) onset: bool,
    pub(super) base: Tick,
    pub(super) batch: heapless::Vec<u8, BATCH_BYTES>,
}

#[derive(Debug)]
pub(super) struct ReorderBuffer(heapless::Vec<Frame, REORDER_WINDOW>);

impl ReorderBuffer {
    pub(super) const fn new() -> Self {
        Self(heapless::Vec::new())
    }

    /// Keeps a frame if it is one of the [`REORDER_WINDOW`] behind `next` and not kept yet.
    pub(super) fn keep(&mut self, next: u16, seq: u16, onset: bool, base: Tick, batch: &[u8]) {
        let ahead = usize::from(seq.wrapping_sub(next));
        if !(1..=REORDER_WINDOW).contains(&ahead) || self.0.iter().any(|kept| kept.seq == seq) {
            return;
        }
        if let Ok(batch) = heapless::Vec::from_slice(batch) {
            // There is room: at most one frame is kept for each of the `REORDER_WINDOW` numbers.
            let _ = self.0.push(Frame { seq, onset, base, batch });
        }
    }

    pub(super) fn take(&mut self, seq: u16) -> Option<Frame> {
        let at = self.0.iter().position(|kept| kept.seq == seq)?;
        Some(self.0.swap_remove(at))
    }

    /// Bit i: frame `next + 1 + i` is kept.
    pub(super) fn mask(&self, next: u16) -> u8 {
        // The one waited for may be among them, for the moment.
        let ahead = self.0.iter().map(|kept| kept.seq.wrapping_sub(next)).filter(|&ahead| ahead > 0);
        ahead.fold(0, |mask, ahead| mask | 1 << ((ahead - 1) % 8))
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }
}
