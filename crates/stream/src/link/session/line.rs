//! The line as a session sees it: its rate, the bytes it carried, and its round trips.

use crate::link::session::contradiction::Contradictions;
use crate::time::HostInstant;
use firmware_protocol::frame::{FrameError, MAX_FRAME};
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
    /// Frames from the device that could not be read.
    pub bad: BadFrames,
    /// Undamaged messages from the device that cannot be true.
    pub contradictions: Contradictions,
}

/// Frames that could not be read, by kind. What they held is lost, or comes again if the protocol repeats it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BadFrames {
    /// No delimiter within the longest frame.
    pub too_long: u64,
    /// Not COBS, or too short.
    pub malformed: u64,
    /// Damaged: the CRC does not fit.
    pub crc: u64,
    /// Undamaged, but not a message of this protocol version: a fault of one of the two programs.
    pub unknown: u64,
}

impl BadFrames {
    /// Counts a frame. One of another version is not counted: it ends the session.
    pub(super) fn count(&mut self, error: FrameError) {
        match error {
            FrameError::TooLong => self.too_long += 1,
            FrameError::Malformed => self.malformed += 1,
            FrameError::Crc => self.crc += 1,
            FrameError::Unknown => self.unknown += 1,
            FrameError::Version(_) => {}
        }
    }
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
