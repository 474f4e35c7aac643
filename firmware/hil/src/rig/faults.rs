//! A line that damages and loses the host's frames at random, the same in every run.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Shares of the host's frames with a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// Lost.
    pub loss: f64,
    /// Sent twice.
    pub repeat: f64,
    /// Damaged by a flipped bit.
    pub corrupt: f64,
}

/// Bytes under way to the device.
#[derive(Debug)]
pub struct FaultyLine {
    faults: Faults,
    random: ChaCha8Rng,
    bytes: Vec<u8>,
}

impl FaultyLine {
    pub(super) fn new(faults: Faults, seed: u64) -> Self {
        Self { faults, random: ChaCha8Rng::seed_from_u64(seed), bytes: Vec::new() }
    }

    pub(super) fn set(&mut self, faults: Faults) {
        self.faults = faults;
    }

    fn chance(&mut self, share: f64) -> bool {
        share > 0.0 && f64::from(self.random.next_u32()) < share * 2f64.powi(32)
    }

    pub(super) fn send(&mut self, frame: &[u8]) {
        if self.chance(self.faults.loss) {
            return;
        }
        let mut frame = frame.to_vec();
        if self.chance(self.faults.corrupt) {
            let at = self.random.next_u32() as usize % frame.len();
            frame[at] ^= 1 << (self.random.next_u32() % 8);
        }
        for _ in 0..1 + usize::from(self.chance(self.faults.repeat)) {
            self.bytes.extend(&frame);
        }
    }

    /// Appends bytes without faults.
    pub(super) fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend(bytes);
    }

    pub(super) fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }

    pub(super) fn clear(&mut self) {
        self.bytes.clear();
    }
}
