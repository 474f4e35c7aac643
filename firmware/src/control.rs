//! Ends a control transfer that the host has given up, so that embassy sees what the host does next.
//!
//! embassy waits for each packet of a control transfer and looks at nothing else of the bus meanwhile. For the host the transfer
//! ends with a reset of the bus, with an unplugged cable (the bus is suspended) and with another SETUP packet. The RP2040 leaves
//! endpoint 0's buffers and the address as they were, so embassy would wait for ever, and the device would answer nobody.
//! [`watch`] takes the buffers back: embassy takes the packet for sent and goes on, packet by packet, until the transfer is over.
//!
//! Invariant: from the event on, until embassy has handled it, endpoint 0 answers NAK. So the host never gets a packet of the transfer
//! that it has given up as the answer to its next one.

use core::convert::Infallible;
use core::future::poll_fn;
use core::task::Poll;
use embassy_rp::pac;

/// Watches for ever. Runs in the task of embassy's device, behind it: each interrupt that embassy wakes the task for polls this, too.
pub(crate) async fn watch() -> Infallible {
    poll_fn(|task| {
        if has_ended() {
            if is_armed() {
                task.waker().wake_by_ref();
            }
            take_back();
        } else {
            if pac::USB.ep_abort().read().0 != 0 {
                pac::USB.ep_abort().write(|w| w.0 = 0);
            }
            if !pac::USB.inte().read().setup_req() {
                // embassy has taken the last SETUP packet, and would not be told of another before it has answered.
                critical_section::with(|_| pac::USB.inte().modify(|w| w.set_setup_req(true)));
            }
        }
        Poll::Pending
    })
    .await
}

/// Whether something has happened that ends a control transfer, and embassy has not handled it yet.
fn has_ended() -> bool {
    let status = pac::USB.sie_status().read();
    status.bus_reset() || status.setup_rec() || (status.suspended() && pac::USB.intr().read().dev_suspend())
}

/// Whether a buffer of endpoint 0 waits for the host.
fn is_armed() -> bool {
    let memory = pac::USB_DPRAM;
    memory.ep_in_buffer_control(0).read().available(0) || memory.ep_out_buffer_control(0).read().available(0)
}

/// Endpoint 0, in and out, in the register by which buffers are revoked.
const ENDPOINT_0: u32 = 0b11;

/// Takes endpoint 0's buffers back, and has it answer NAK. No packet of theirs is under way: the host has ended their transfer.
#[inline(always)]
pub(crate) fn take_back() {
    pac::USB.ep_abort().write(|w| w.0 = ENDPOINT_0);
    pac::USB_DPRAM.ep_in_buffer_control(0).write(|w| w.0 = 0);
    pac::USB_DPRAM.ep_out_buffer_control(0).write(|w| w.0 = 0);
}
