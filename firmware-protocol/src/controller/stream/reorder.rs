//! Buffers frames of the ordered stream that arrive out of order, so that a lost frame costs one round trip.
//!
//! The controller takes a buffered frame when all frames before it have arrived. At most [`REORDER_WINDOW`] are buffered.

use crate::batch::BATCH_BYTES;
use crate::controller::stream::taking::Next;

/// Most frames buffered: those that follow the next in order.
pub const REORDER_WINDOW: usize = 8;

/// A frame of moves as received.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    pub(super) head: Next,
    pub(super) batch: heapless::Vec<u8, BATCH_BYTES>,
}

#[derive(Clone, Debug)]
pub(super) struct ReorderBuffer(heapless::Vec<Frame, REORDER_WINDOW>);

impl ReorderBuffer {
    pub(super) const fn new() -> Self {
        Self(heapless::Vec::new())
    }

    /// Buffers a frame if it is one of the [`REORDER_WINDOW`] frames after `next` and not buffered yet.
    pub(super) fn insert(&mut self, next: u16, head: Next, batch: &[u8]) {
        let ahead = usize::from(head.seq.wrapping_sub(next));
        if !(1..=REORDER_WINDOW).contains(&ahead) || self.0.iter().any(|frame| frame.head.seq == head.seq) {
            return;
        }
        if let Ok(batch) = heapless::Vec::from_slice(batch) {
            // There is room: each of the `REORDER_WINDOW` numbers is buffered at most once.
            let _ = self.0.push(Frame { head, batch });
        }
    }

    pub(super) fn take(&mut self, seq: u16) -> Option<Frame> {
        let at = self.0.iter().position(|frame| frame.head.seq == seq)?;
        Some(self.0.swap_remove(at))
    }

    /// Bit i: frame `next + 1 + i` is buffered.
    pub(super) fn mask(&self, next: u16) -> u8 {
        // Frame `next` itself may be among them for a moment.
        let ahead = self.0.iter().map(|frame| frame.head.seq.wrapping_sub(next)).filter(|&ahead| ahead > 0);
        ahead.fold(0, |mask, ahead| mask | 1 << ((ahead - 1) % 8))
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }
}
