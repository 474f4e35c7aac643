//! The measured bursts of the last minute.
//!
//! Invariant: at most [`MAX_PER_MOTOR`] for each motor are kept, and none that began more than [`KEPT_S`] before the newest.

use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_stream::queues::MeasuredBurst;
use std::collections::VecDeque;

/// How long they are kept, s: a prediction reads the first minute of a play, soon after that minute.
pub const KEPT_S: u64 = 65;
/// How many are kept of each motor: 300 Hz for that long, 1.2 MB; a fifth of that at 60 Hz.
const MAX_PER_MOTOR: usize = 600 * KEPT_S as usize;

/// Measured bursts, in order of arrival: those of one motor in order of time.
#[derive(Debug)]
pub struct MeasuredBursts {
    array: Array,
    kept: VecDeque<MeasuredBurst>,
}

impl MeasuredBursts {
    /// None yet, of this array.
    #[must_use]
    pub const fn new(array: Array) -> Self {
        Self { array, kept: VecDeque::new() }
    }

    /// Adds a burst.
    pub fn add(&mut self, burst: MeasuredBurst) {
        let old = |first: &MeasuredBurst| burst.start - first.start > KEPT_S * self.array.rate().per_s();
        while self.kept.front().is_some_and(old) || self.kept.len() >= self.array.motors() * MAX_PER_MOTOR {
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
