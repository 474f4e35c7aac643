//! The line as a session sees it: its rate, the bytes it carried, and its round trips.

use crate::time::HostInstant;
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::tick::Tick;
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
    #[must_use]
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
    /// When the host sent the ping.
    pub sent: HostInstant,
    /// The device's clock when it answered.
    pub tick: Tick,
    /// When the host received the answer.
    pub received: HostInstant,
}
