//! What bursts really came to, as far back as somebody may ask.
//!
//! Invariant: no more than [`MOST`] are kept, and none that began more than [`KEPT_S`] before the newest.

use firmware_protocol::tick::Tick;
use meissner_array::units::TICKS_PER_S;
use meissner_stream::queues::MeasuredBurst;
use std::collections::VecDeque;

/// For how long they are kept, s: what is asked is at most the first minute of a play, and is asked when that is over.
pub const KEPT_S: u64 = 65;
/// How many are kept: 24 motors at 300 Hz for that long, 30 MB. At 60 Hz it is a fifth.
const MOST: usize = 24 * 600 * KEPT_S as usize;

/// Measured bursts, in the order in which they were told: by motor in order of time.
#[derive(Debug, Default)]
pub struct MeasuredBursts {
    kept: VecDeque<MeasuredBurst>,
}

impl MeasuredBursts {
    /// Takes one in.
    pub fn add(&mut self, traveled: MeasuredBurst) {
        let old = |first: &MeasuredBurst| traveled.start - first.start > KEPT_S * TICKS_PER_S;
        while self.kept.front().is_some_and(old) || self.kept.len() >= MOST {
            self.kept.pop_front();
        }
        self.kept.push_back(traveled);
    }

    /// Another device, another clock: forgets all.
    pub fn clear(&mut self) {
        self.kept = VecDeque::new();
    }

    /// Those that began within `from..until`.
    pub fn within(&self, from: Tick, until: Tick) -> impl Iterator<Item = &MeasuredBurst> {
        self.kept.iter().filter(move |traveled| (from..until).contains(&traveled.start))
    }
}
