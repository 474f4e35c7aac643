//! The executor's heartbeat: tasks count beats, and the shell checks that they go on.
//!
//! A hung executor moves no packets. The shell, an interrupt above it, still plays; so it returns the pins in time before the
//! watchdog restarts the chip.

use crate::array::LAYOUT;
use core::sync::atomic::{AtomicU32, Ordering::SeqCst};
use embassy_time::Duration;
use firmware_protocol::tick::Tick;

/// Most time between two beats of a task that does nothing else.
pub(crate) const EVERY: Duration = Duration::from_millis(2);
/// Ticks without a beat after which the executor counts as hung: 10 ms.
const HUNG: u64 = LAYOUT.tick_hz() as u64 / 100;

static BEATS: AtomicU32 = AtomicU32::new(0);

/// Counts a beat. From the executor. The bench plants a hang here, by this name.
#[unsafe(no_mangle)]
#[inline(never)]
pub(crate) extern "C" fn executor_beats() {
    BEATS.store(BEATS.load(SeqCst).wrapping_add(1), SeqCst);
}

/// Sees when the beats stop.
pub(crate) struct Watch {
    beats: u32,
    /// When the last beat was seen.
    since: Tick,
}

impl Watch {
    pub(crate) const NEW: Self = Self { beats: 0, since: Tick::BOOT };

    /// Whether the executor hangs: true once, until it beats again.
    pub(crate) fn hangs(&mut self, now: Tick) -> bool {
        let beats = BEATS.load(SeqCst);
        if beats != self.beats {
            (self.beats, self.since) = (beats, now);
        }
        let hangs = now - self.since > HUNG;
        if hangs {
            self.since = Tick(u64::MAX);
        }
        hangs
    }
}
