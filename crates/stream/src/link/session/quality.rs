//! How long frames of strokes should be on a line that damages bytes.
//!
//! The session reports what it sends, and how many frames the device could not read. It knows no rates: [`Line`](super::line::Line)
//! does. Invariant: frames are between [`SHORTEST`] bytes and the longest, and get no longer while more bytes are damaged.

use firmware_protocol::frame::MAX_FRAME;

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
