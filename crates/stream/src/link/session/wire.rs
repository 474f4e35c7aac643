//! What goes over the wire: bytes become messages, and all is counted.
//!
//! A damaged frame counts as never sent: the device sends again what matters. [`Wire`] tells whether the line is noisy, and so why a
//! device is silent.
//!
//! Invariant: each frame from the device counts once, as good or as bad; one of another version ends the session instead.

use crate::link::session::contradiction::{Contradiction, Contradictions};
use crate::link::session::event::LostReason;
use firmware_protocol::frame::{self, Decoder, FrameError};
use firmware_protocol::message::DeviceMessage;

/// So many damaged frames in a row make a line noisy.
const NOISE: u32 = 5;

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
    fn damaged_percent(&self) -> u64 {
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
    fn count(&mut self, error: FrameError) {
        match error {
            FrameError::TooLong => self.too_long += 1,
            FrameError::Malformed => self.malformed += 1,
            FrameError::Crc => self.crc += 1,
            FrameError::Unknown => self.unknown += 1,
            FrameError::Version(_) => {}
        }
    }
}

/// The bytes of a session.
#[derive(Clone, Debug, Default)]
pub(super) struct Wire {
    decoder: Decoder,
    traffic: Traffic,
    /// Damaged frames since the last whole one.
    noise: u32,
}

impl Wire {
    pub(super) const fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// A frame of so many bytes leaves.
    pub(super) const fn sent(&mut self, len: usize) {
        self.traffic.bytes_out += len as u64;
    }

    /// A frame leaves, perhaps again.
    pub(super) fn repeated(&mut self, again: bool) {
        self.traffic.retransmitted += u64::from(again);
    }

    /// So many bytes came, which [`Self::next`] reads.
    pub(super) const fn received(&mut self, len: usize) {
        self.traffic.bytes_in += len as u64;
    }

    /// The next message in `bytes`, of which it takes what it reads. The error is that of another version.
    pub(super) fn next(&mut self, bytes: &mut &[u8]) -> Option<Result<DeviceMessage, FrameError>> {
        while let Some(body) = self.decoder.next(bytes) {
            match frame::read(body) {
                Ok(message) => {
                    (self.traffic.good, self.noise) = (self.traffic.good + 1, 0);
                    return Some(Ok(message));
                }
                Err(FrameError::Version(version)) => return Some(Err(FrameError::Version(version))),
                Err(error) => {
                    self.noise = self.noise.saturating_add(1);
                    self.traffic.bad.count(error);
                }
            }
        }
        None
    }

    /// Counts a message that cannot be true; returns whether it is the first of its kind.
    pub(super) fn contradicted(&mut self, how: Contradiction) -> bool {
        self.traffic.contradictions.count(how)
    }

    /// Whether the last frame was damaged.
    pub(super) const fn is_disturbed(&self) -> bool {
        self.noise > 0
    }

    /// Whether the line damages all of what the device says.
    pub(super) const fn is_noisy(&self) -> bool {
        self.noise >= NOISE
    }

    /// Why a device that does not answer counts as lost.
    pub(super) fn silence(&self, otherwise: LostReason) -> LostReason {
        if self.is_noisy() {
            LostReason::Noisy { percent: self.traffic.damaged_percent() as u8 }
        } else {
            otherwise
        }
    }
}
