//! What the firmware counts about its own board since it started, and why it started.
//!
//! Other modules count here what they notice; [`read`] gives all of it at once, from any context. The bench reads the
//! counters by their names.

use crate::board;
use core::sync::atomic::{AtomicU32, Ordering::SeqCst};
use embassy_rp::pac;
use firmware_protocol::board::{Counts, Measures, Reset};
use firmware_protocol::controller::HORIZON;
use firmware_protocol::message::Cause;

/// Least ticks between the end of a block's rendering and the fetch of its first word, while enabled.
#[unsafe(no_mangle)]
static SLACK_MIN: AtomicU32 = AtomicU32::new(HORIZON);
/// Times that the executor hung.
#[unsafe(no_mangle)]
static STALLS: AtomicU32 = AtomicU32::new(0);
/// Times that a hung USB controller was set up again.
#[unsafe(no_mangle)]
static USB_RECOVERIES: AtomicU32 = AtomicU32::new(0);
/// The reason of the start, by its number in [`RESETS`].
#[unsafe(no_mangle)]
static RESET: AtomicU32 = AtomicU32::new(0);

/// The reasons in the order of their numbers.
const RESETS: [Reset; 6] =
    [Reset::Unknown, Reset::Power, Reset::RunPin, Reset::Debugger, Reset::Watchdog, Reset::Panic];
/// GPIOs that were high before anything drove them.
static HIGH_AT_BOOT: AtomicU32 = AtomicU32::new(0);

/// The counters now, without the slack: the controller keeps that, window by window.
pub(crate) fn read() -> Measures {
    let reset = RESETS.get(RESET.load(SeqCst) as usize).copied();
    Measures {
        reset: reset.unwrap_or_default(),
        counts: Counts {
            stalls: Some(STALLS.load(SeqCst)),
            usb_recoveries: Some(USB_RECOVERIES.load(SeqCst)),
            ..Counts::NONE
        },
        high_at_boot: Some(board::outputs(HIGH_AT_BOOT.load(SeqCst))),
    }
}

/// Keeps why the chip has started: `cause` is what the watchdog's registers say. Called once.
pub(crate) fn started(cause: Cause) {
    let chip = pac::VREG_AND_CHIP_RESET.chip_reset().read();
    let reset = match cause {
        Cause::Watchdog => Reset::Watchdog,
        Cause::Panic => Reset::Panic,
        // The registers keep these over a restart by the watchdog, so they come last.
        _ if chip.had_run() => Reset::RunPin,
        _ if chip.had_psm_restart() => Reset::Debugger,
        _ if chip.had_por() => Reset::Power,
        _ => Reset::Unknown,
    };
    let number = RESETS.iter().position(|&known| known == reset).unwrap_or(0);
    RESET.store(number as u32, SeqCst);
}

/// Keeps which outputs are high. Called once, before anything drives them.
pub(crate) fn look_at_outputs() {
    HIGH_AT_BOOT.store(pac::SIO.gpio_in(0).read(), SeqCst);
}

/// Keeps the slack of a block: the ticks from the end of its rendering to the fetch of its first word. Only the shell calls it.
pub(crate) fn rendered(slack: u32) {
    SLACK_MIN.store(slack.min(SLACK_MIN.load(SeqCst)), SeqCst);
}

/// Counts a hang of the executor. Only the shell calls it.
pub(crate) fn stalled() {
    STALLS.store(STALLS.load(SeqCst).wrapping_add(1), SeqCst);
}

/// Counts that a hung USB controller is set up again. Only the task that does it calls this.
pub(crate) fn usb_recovered() {
    USB_RECOVERIES.store(USB_RECOVERIES.load(SeqCst).wrapping_add(1), SeqCst);
}
