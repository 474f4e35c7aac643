//! The e-stop that waits for its thread: a newer one replaces it.
//!
//! Any thread calls [`Newest::set`] and wakes the thread that runs [`Newest::serve`]. `verify/races` explores their interleavings.
//!
//! Invariant: the last epoch that was set is sent, unless the end comes first.

use crate::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use crate::sync::{Thread, park};

/// A request waits; its epoch is in the low half.
const WAITS: u32 = 1 << 16;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Newest {
    /// [`WAITS`] and the epoch, or 0.
    request: AtomicU32,
    end: AtomicBool,
}

impl Newest {
    /// Has this epoch sent by the thread. It never blocks.
    pub(super) fn set(&self, epoch: u16, server: &Thread) {
        // A swap, as in `serve`: the model checker does not know that a store cannot fall between the two halves of a swap.
        let _ = self.request.swap(WAITS | u32::from(epoch), Ordering::AcqRel);
        server.unpark();
    }

    /// Ends the thread. What waits need not be sent any more.
    pub(super) fn end(&self, server: &Thread) {
        self.end.store(true, Ordering::Release);
        server.unpark();
    }

    /// Sends what is set, until the end.
    pub(super) fn serve(&self, mut send: impl FnMut(u16)) {
        while !self.end.load(Ordering::Acquire) {
            match self.request.swap(0, Ordering::AcqRel) {
                0 => park(),
                request => send(request as u16),
            }
        }
    }
}
