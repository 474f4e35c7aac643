//! Passes an e-stop from the USB interrupt to the shell, past the packets that wait before it.
//!
//! The interrupt calls [`found`], which forces the lines low at once. The shell learns of it by [`pending`], has
//! the controller carry it out and calls [`done`]. Between the two the controller's clock stands still, so it books the right pulses.
//! Invariant: once the lines are forced low, the controller turns them off and latches, whatever became of the session.

use crate::{wake, wave};
use core::sync::atomic::{AtomicU32, Ordering::SeqCst};
use firmware_protocol::controller::newer;

/// The controller's epoch, for the USB interrupt: [`SOME`] and the epoch, or 0 without a session.
static EPOCH: AtomicU32 = AtomicU32::new(0);
/// An e-stop that the controller does not know of yet: [`SOME`] and its epoch, or 0.
static PENDING: AtomicU32 = AtomicU32::new(0);
const SOME: u32 = 1 << 16;

/// Sets the epoch that a new e-stop must be newer than; `None` without a session.
pub(crate) fn set_epoch(epoch: Option<u16>) {
    EPOCH.store(epoch.map_or(0, |epoch| SOME | u32::from(epoch)), SeqCst);
}

/// Whether an e-stop of this epoch is new to the session.
pub(crate) fn is_new(epoch: u16) -> bool {
    let present = EPOCH.load(SeqCst);
    present & SOME != 0 && newer(epoch, present as u16)
}

/// Forces the lines low if this e-stop is new. Without a session, every e-stop that comes by a control request (`by_request`) is
/// new. Call it from the USB interrupt, or with interrupts off.
#[inline(never)]
pub(crate) fn found(epoch: u16, by_request: bool) {
    let new = is_new(epoch) || (by_request && EPOCH.load(SeqCst) & SOME == 0);
    if new && PENDING.load(SeqCst) == 0 {
        wave::freeze_low();
        PENDING.store(SOME | u32::from(epoch), SeqCst);
        wake::shell();
    }
}

/// The epoch of an e-stop that the controller does not know of yet.
pub(crate) fn pending() -> Option<u16> {
    let pending = PENDING.load(SeqCst);
    (pending & SOME != 0).then_some(pending as u16)
}

/// The controller has carried out the pending e-stop: its clock runs again.
pub(crate) fn done() {
    PENDING.store(0, SeqCst);
    wave::unfreeze();
}
