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
    /// Frames from the device that were read.
    pub good: u64,
    /// Frames from the device that could not be read.
    pub bad: BadFrames,
    /// Undamaged messages from the device that cannot be true.
    pub contradictions: Contradictions,
}

impl Traffic {
    /// The share of the device's frames that the line damaged, percent.
    pub(super) fn damaged_percent(&self) -> u64 {
        let bad = self.bad.too_long + self.bad.malformed + self.bad.crc;
        (100 * bad).checked_div(bad + self.good).unwrap_or(0)
    }
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

/// Bytes of a frame of strokes besides the strokes, about.
const HEADER: f64 = 24.0;
/// Frames after which the quality is judged again. Older ones count half each time.
const JUDGED: u32 = 64;
/// Shorter frames carry more header than strokes.
const SHORTEST: usize = 64;

/// How much of what the host sends gets through: the device counts the frames that it cannot read.
///
/// Of a line that damages one byte in 1/λ, a frame of n bytes survives with exp(-λn). The length that carries most is that
/// at which `(n - HEADER)·exp(-λn)` is largest.
#[derive(Clone, Debug)]
pub(super) struct Quality {
    frames: u32,
    bytes: usize,
    damaged: u64,
    /// The device's count when it was last heard.
    counted: Option<u64>,
    /// Most bytes of a frame of strokes.
    pub(super) frame_bytes: usize,
    /// What such frames carry, of what full frames carry on a good line.
    pub(super) share: f64,
}

impl Default for Quality {
    fn default() -> Self {
        Self { frames: 0, bytes: 0, damaged: 0, counted: None, frame_bytes: MAX_FRAME, share: 1.0 }
    }
}

impl Quality {
    /// A frame of so many bytes leaves.
    pub(super) fn sent(&mut self, len: usize) {
        (self.frames, self.bytes) = (self.frames.saturating_add(1), self.bytes.saturating_add(len));
    }

    /// The device's count of frames that it could not read since its start.
    pub(super) fn heard(&mut self, bad_frames: u64) {
        self.damaged += bad_frames.saturating_sub(self.counted.unwrap_or(bad_frames));
        self.counted = Some(bad_frames);
        if self.frames >= JUDGED {
            self.judge();
            (self.frames, self.bytes, self.damaged) = (self.frames / 2, self.bytes / 2, self.damaged / 2);
        }
    }

    fn judge(&mut self) {
        let survive = 1.0 - self.damaged as f64 / f64::from(self.frames);
        let per_byte =
            (-survive.clamp(0.02, 1.0).ln() * f64::from(self.frames) / self.bytes as f64).max(1e-9);
        // In steps, so that chance does not change it all the time.
        let best = HEADER / 2.0 * (1.0 + (1.0 + 4.0 / (HEADER * per_byte)).sqrt());
        self.frame_bytes = (best as usize / 32 * 32).clamp(SHORTEST, MAX_FRAME);
        let payload = |bytes: f64| 1.0 - HEADER / bytes;
        let bytes = self.frame_bytes as f64;
        let share = payload(bytes) / payload(MAX_FRAME as f64) * (-per_byte * bytes).exp();
        self.share = (share * 16.0).ceil() / 16.0;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The quality after frames of 60 bytes over a line that damages this share of bytes.
    fn quality(share: f64) -> Quality {
        let (mut quality, mut damaged) = (Quality::default(), 0.0);
        for _ in 0..400 {
            quality.sent(60);
            damaged += 1.0 - (1.0 - share).powi(60);
            quality.heard(damaged as u64);
        }
        quality
    }

    #[test]
    fn the_more_bytes_are_damaged_the_shorter_are_the_frames() {
        let good = quality(0.0);
        assert_eq!((good.frame_bytes, good.share), (MAX_FRAME, 1.0));
        let lengths = [0.0001, 0.001, 0.005, 0.01, 0.02, 0.1].map(|share| quality(share).frame_bytes);
        assert!(lengths.is_sorted_by(|longer, shorter| longer >= shorter), "{lengths:?}");
        assert_eq!((lengths[0], lengths[5]), (MAX_FRAME, SHORTEST));
        let shares = [0.001, 0.01, 0.05].map(|share| quality(share).share);
        assert!(shares[0] > shares[1] && shares[1] > shares[2] && shares[2] > 0.0, "{shares:?}");
    }
}
