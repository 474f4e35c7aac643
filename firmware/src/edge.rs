//! The trigger input: takes the tick of each rising edge.
//!
//! The interrupt takes the tick and masks the input. The shell passes the tick to the controller ([`take`]) and unmasks the input when
//! the dead time is over ([`listen`]). So a noisy wire interrupts once in each dead time.
//!
//! Priority: above the shell, below clock and USB. So an edge delays neither an e-stop nor the supervision of the waveform, and a tick is
//! late only by what these two take.
//!
//! Invariant: the interrupt is masked from the moment it has written a tick until the shell has taken it.

use crate::array::LAYOUT;
use crate::board::TRIGGER_INPUT;
use crate::{wake, wave};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::SeqCst};
use embassy_rp::interrupt;
use embassy_rp::interrupt::{InterruptExt, Priority};
use embassy_rp::pac;
use firmware_protocol::tick::Tick;

/// The interrupt's entry in the vector table. embassy has a handler of its own for it, which would only wake a task.
pub(crate) const VECTOR: usize = 16 + pac::Interrupt::IO_IRQ_BANK0 as usize;

/// The tick of the last edge, low and high half.
static TICK: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];
/// An edge that the shell has not taken.
static CAME: AtomicBool = AtomicBool::new(false);

/// Sets the input up. An edge from before [`listen`] does not count.
pub(crate) fn start() {
    let Some(pin) = TRIGGER_INPUT else { return };
    pac::PADS_BANK0.gpio(pin.into()).write(|w| {
        w.set_ie(true);
        w.set_pde(true);
        w.set_schmitt(true);
        w.set_od(true);
    });
    interrupt::IO_IRQ_BANK0.set_priority(Priority::P1);
}

/// The handler of the interrupt.
pub(crate) extern "C" fn came() {
    let tick = wave::running().0;
    listens(false);
    TICK[0].store(tick as u32, SeqCst);
    TICK[1].store((tick >> 32) as u32, SeqCst);
    CAME.store(true, SeqCst);
    wake::shell();
}

/// The tick of a new edge. Only the shell calls it.
pub(crate) fn take() -> Option<Tick> {
    let came = TRIGGER_INPUT.is_some() && CAME.load(SeqCst);
    came.then(|| {
        CAME.store(false, SeqCst);
        last()
    })
}

/// Unmasks the input when the dead time after the last edge is over. Only the shell calls it.
pub(crate) fn listen(now: Tick) {
    let Some(pin) = TRIGGER_INPUT.map(usize::from) else { return };
    let masked = !pac::IO_BANK0.int_proc(0).inte(pin / 8).read().edge_high(pin % 8);
    if masked && !CAME.load(SeqCst) && now >= last() + u64::from(LAYOUT.edge_dead_time()) {
        // Edges of the dead time are latched.
        pac::IO_BANK0.intr(pin / 8).write(|w| w.set_edge_high(pin % 8, true));
        listens(true);
    }
}

fn last() -> Tick {
    Tick(u64::from(TICK[1].load(SeqCst)) << 32 | u64::from(TICK[0].load(SeqCst)))
}

fn listens(on: bool) {
    if let Some(pin) = TRIGGER_INPUT.map(usize::from) {
        pac::IO_BANK0.int_proc(0).inte(pin / 8).write(|w| w.set_edge_high(pin % 8, on));
    }
}
