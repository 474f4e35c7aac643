//! The measured bursts of the last minute.
//!
//! Invariant: at most [`MAX_BURSTS`] are kept, and none that began more than [`KEPT_S`] before the newest.

use firmware_protocol::tick::Tick;
use meissner_array::units::TICKS_PER_S;
use meissner_stream::queues::MeasuredBurst;
use std::collections::VecDeque;

/// How long they are kept, s: a prediction reads the first minute of a play, soon after that minute.
pub const KEPT_S: u64 = 65;
/// How many are kept: 24 motors at 300 Hz for that long, 30 MB; a fifth of that at 60 Hz.
const MAX_BURSTS: usize = 24 * 600 * KEPT_S as usize;

/// Measured bursts, in order of arrival: those of one motor in order of time.
#[derive(Debug, Default)]
pub struct MeasuredBursts {
    kept: VecDeque<MeasuredBurst>,
}

impl MeasuredBursts {
    /// Adds a burst.
    pub fn add(&mut self, burst: MeasuredBurst) {
        let old = |first: &MeasuredBurst| burst.start - first.start > KEPT_S * TICKS_PER_S;
        while self.kept.front().is_some_and(old) || self.kept.len() >= MAX_BURSTS {
            self.kept.pop_front();
        }
        self.kept.push_back(burst);
    }

    /// Removes all bursts, because another device has another clock.
    pub fn clear(&mut self) {
        self.kept = VecDeque::new();
    }

    /// The bursts that began within `from..until`.
    pub fn within(&self, from: Tick, until: Tick) -> impl Iterator<Item = &MeasuredBurst> {
        self.kept.iter().filter(move |burst| (from..until).contains(&burst.start))
    }
}
