//! Limits the time that the acceptor gives to clients of the API. Emergency stops do not wait for a window.

use std::time::{Duration, Instant};

/// The length of a window: short, so that clients wait little.
const WINDOW: Duration = Duration::from_millis(4);
/// The time for clients in each window. Linux stops real-time threads that run for more than 95 % of a second.
const SHARE: Duration = Duration::from_millis(2);

/// The time for clients of the API: [`SHARE`] of each [`WINDOW`]. A flood of connections must not use up the processor time that
/// the system leaves to real-time threads: the streamer needs it.
#[derive(Debug)]
pub(super) struct Window {
    begun: Instant,
    /// How much of the time clients have used.
    pub(super) used: Duration,
}

impl Window {
    pub(super) fn new() -> Self {
        Self { begun: Instant::now(), used: Duration::ZERO }
    }

    /// When the next window begins.
    pub(super) fn end(&self) -> Instant {
        // Rest at least as long as the work, even after a round that took longer than the window.
        self.begun + WINDOW.max(2 * self.used)
    }

    /// Returns `now` if there is time left for clients.
    pub(super) fn open(&mut self, now: Instant) -> Option<Instant> {
        if now >= self.end() {
            *self = Self { begun: now, used: Duration::ZERO };
        }
        (self.used < SHARE).then_some(now)
    }
}
