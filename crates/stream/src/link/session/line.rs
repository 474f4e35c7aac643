//! The line as a session sees it: its rate, what went over it, how long it took.

use crate::time::HostInstant;
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::tick::Tick;
use std::time::Duration;

/// How fast bytes leave on the line, bytes per second: bounds what may wait in buffers we cannot reach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineRate(pub u32);

impl LineRate {
    /// Bytes that may be on their way: 2 ms of the line, at least one frame.
    pub(super) fn window_bytes(self) -> usize {
        (self.0 as usize / 500).max(MAX_FRAME)
    }

    /// How long so many bytes are on the line.
    #[must_use]
    pub fn time(self, bytes: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 / f64::from(self.0.max(1)))
    }
}

/// Bytes and frames since the session began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes sent, all overhead included.
    pub bytes_out: u64,
    /// Bytes received.
    pub bytes_in: u64,
    /// Frames sent again.
    pub retransmitted: u64,
}

/// A ping and its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoundTrip {
    /// When it was sent.
    pub sent: HostInstant,
    /// The device's clock in between.
    pub tick: Tick,
    /// When the answer was heard.
    pub received: HostInstant,
}
