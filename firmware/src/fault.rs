//! Panics, hard faults and hangs: turns all outputs low at once, then the watchdog restarts the chip.
//!
//! A reset makes all pins inputs with pull-downs. [`watchdog`] then tells why the chip restarted.

use crate::{beat, shell, wave};
use core::panic::PanicInfo;
use cortex_m_rt::exception;
use embassy_rp::Peri;
use embassy_rp::pac;
use embassy_rp::peripherals::WATCHDOG;
use embassy_rp::watchdog::Watchdog;
use embassy_time::{Duration, Timer};
use firmware_protocol::message::Cause;

/// The watchdog restarts the chip after its shell or executor has hung for this time.
const TIMEOUT: Duration = Duration::from_millis(100);
/// Written to a register that survives the watchdog's reset: the firmware stopped itself.
const DIED: u32 = 0x6d65_6973;

/// Starts the watchdog and returns why the chip started.
pub(crate) fn watchdog(peripheral: Peri<'static, WATCHDOG>) -> (Watchdog, Cause) {
    let mut watchdog = Watchdog::new(peripheral);
    let cause = match watchdog.reset_reason() {
        None => Cause::Boot,
        Some(_) if watchdog.get_scratch(0) == DIED => Cause::Panic,
        Some(_) => Cause::Watchdog,
    };
    watchdog.set_scratch(0, 0);
    watchdog.pause_on_debug(true);
    watchdog.start(TIMEOUT);
    (watchdog, cause)
}

/// Beats, and feeds the watchdog while this task runs and the shell takes its turns.
pub(crate) async fn feed(mut watchdog: Watchdog) -> ! {
    let mut before = shell::turns().wrapping_sub(1);
    loop {
        let turns = shell::turns();
        if turns != before {
            watchdog.feed(TIMEOUT);
        }
        before = turns;
        beat::executor_beats();
        Timer::after(beat::EVERY).await;
    }
}

/// Turns all outputs low and waits for the watchdog's reset.
fn die() -> ! {
    cortex_m::interrupt::disable();
    wave::force_low();
    pac::WATCHDOG.scratch0().write_value(DIED);
    loop {
        cortex_m::asm::nop();
    }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    die()
}

#[exception(trampoline = false)]
// SAFETY: it never returns and relies on no state.
unsafe fn HardFault() -> ! {
    die()
}

#[exception]
// SAFETY: as above.
unsafe fn DefaultHandler(_: i16) -> ! {
    die()
}
