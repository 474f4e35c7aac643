//! The latch of the emergency stop: it holds without a device too, and concerns one that comes later.
//!
//! The e-stop that a session sends of its own, because the device contradicts itself, is not latched: the next session resets it.
//!
//! Invariant: only a reset that knows of the newest emergency stop opens the latch.

use crate::queues::{CommandError, ESTOP_TICKETS};
use firmware_protocol::message::{Cause, State, Status};

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Latch {
    latched: bool,
    /// The number of the newest emergency stop.
    newest: u64,
    /// The last session sent an e-stop of its own.
    resets_own: bool,
}

impl Latch {
    /// An emergency stop was ordered, perhaps by the switch, whose tickets have numbers.
    pub(super) fn close(&mut self, ticket: u64) {
        let newest = self.newest.max(ticket.saturating_sub(ESTOP_TICKETS));
        *self = Self { latched: true, newest, resets_own: false };
    }

    /// A client that knows of the emergency stops up to number `seen` resets them.
    pub(super) const fn open(&mut self, seen: u64) -> Result<(), CommandError> {
        if self.newest > seen {
            return Err(CommandError::Faulted);
        }
        self.latched = false;
        Ok(())
    }

    pub(super) const fn is_closed(&self) -> bool {
        self.latched
    }

    /// The session is over; `own`: it has sent an e-stop to a device that had none.
    pub(super) const fn session_over(&mut self, own: bool) {
        self.resets_own = own;
    }

    /// Whether the device, which reports this status, is to be reset after the e-stop of the session before.
    pub(super) fn resets_own(&mut self, status: &Status) -> bool {
        self.resets_own &= (status.state, status.cause) == (State::Faulted, Cause::EStop);
        self.resets_own && !self.latched
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reset_of_older_emergency_stops_does_not_open() {
        let mut latch = Latch::default();
        latch.close(ESTOP_TICKETS + 2);
        latch.close(7);
        assert_eq!(latch.open(1), Err(CommandError::Faulted));
        assert!(latch.is_closed());
        assert_eq!(latch.open(2), Ok(()));
        assert!(!latch.is_closed());
    }
}
