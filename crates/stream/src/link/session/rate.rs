//! Rates: what a line is said to carry, and what it was measured to carry.
//!
//! The transport names a [`LineRate`]; the probe finds a [`MeasuredLine`] of at most that. Invariant: no rate lets less than a frame
//! be unacknowledged.

use firmware_protocol::frame::MAX_FRAME;
use std::time::Duration;

/// The rate of a line, bytes per second. It bounds what may wait in buffers that the host cannot reach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineRate(pub u32);

impl LineRate {
    /// Bulk transfers of a full-speed USB device.
    pub const USB_FULL_SPEED: Self = Self(800_000);

    /// Bytes that may be unacknowledged: 2 ms of the line, at least one frame.
    pub(super) fn window_bytes(self) -> usize {
        (self.0 as usize / 500).max(MAX_FRAME)
    }

    /// How long `bytes` occupy the line.
    pub fn time(self, bytes: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 / f64::from(self.0.max(1)))
    }
}

/// What the link probe measured.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeasuredLine {
    /// What the line carries while nothing waits for an answer, at most its nominal rate.
    pub(super) rate: LineRate,
    /// How long an acknowledgement takes, besides the bytes' own time on the line.
    pub(super) ack_wait: Duration,
}
