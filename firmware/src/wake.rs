//! Wakes the shell: requests the software interrupt in which it runs.
//!
//! The clock calls this at each block, USB with each packet. It lies below all of them, so that none of them depends on the
//! shell.

use embassy_rp::interrupt;
use embassy_rp::interrupt::InterruptExt;

/// Has the shell take a turn. From any context.
pub(crate) fn shell() {
    interrupt::SWI_IRQ_0.pend();
}
