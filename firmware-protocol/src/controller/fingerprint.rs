//! What a controller will do from now on, for programs that explore all orders of events and stop at a state that they have met.
//!
//! Invariant: two controllers with the same fingerprint at the same tick behave alike from then on, and have counted the same.
//! The fingerprint leaves out what no longer matters: free slots, bytes and moves that are taken, ticks that have passed. The
//! code names every field of the controller, so a new field does not compile until somebody has decided about it.

use crate::controller::Controller;
use core::hash::{Hash, Hasher};

impl Controller {
    /// Adds to `hasher` what the controller will do from now on. It leaves out what is only for people: the identity, the time since
    /// the start, the last cut in the handshake.
    pub fn fingerprint(&self, hasher: &mut impl Hasher) {
        let Self { identity: _, inbox, session, stream, motion, player, reporting, board, edges, now } = self;
        (inbox, session, stream, player, reporting, board, now).hash(hasher);
        edges.fingerprint(*now, hasher);
        motion.fingerprint(*now, hasher);
    }

    /// Whether each pin that is above its goal comes down or waits to, each pin below it goes up, and each move that waits will begin.
    #[must_use]
    pub fn is_consistent(&self) -> bool {
        self.player.is_consistent()
    }
}
