//! The repeats of a pattern: when each begins and ends, in ticks from the beginning of the play.
//!
//! Invariant: repeat k begins at `floor(k * duration_s * tick_hz + 0.5)` and ends where the next begins; a pattern without a
//! duration has one repeat without end.

use super::drive::NEVER;
use crate::units::TickRate;

/// One run of the pattern.
#[derive(Clone, Copy, Debug)]
pub(super) struct Repeat {
    pub(super) number: u64,
    pub(super) start: u64,
    pub(super) end: u64,
}

impl Repeat {
    pub(super) fn of(number: u64, duration_s: Option<f64>, rate: TickRate) -> Self {
        let end = if duration_s.is_some() { begin(number + 1, duration_s, rate) } else { NEVER };
        Self { number, start: begin(number, duration_s, rate), end }
    }

    /// The repeat in which a play that ends at `play_end` ends.
    pub(super) fn last(duration_s: Option<f64>, rate: TickRate, play_end: u64) -> Self {
        let about = duration_s.map_or(0.0, |duration_s| rate.ticks_to_seconds(play_end) / duration_s) as u64;
        let mut last = Self::of(about, duration_s, rate);
        while last.number > 0 && last.start >= play_end {
            last = Self::of(last.number - 1, duration_s, rate);
        }
        while last.end < play_end {
            last = Self::of(last.number + 1, duration_s, rate);
        }
        last
    }

    /// The next repeat that lasts `ticks` or longer. The lengths of repeats differ by a tick, because their beginnings are rounded,
    /// so many repeats in a row may be too short. This is a binary search.
    pub(super) fn next(self, ticks: u64, duration_s: Option<f64>, rate: TickRate, play_end: u64) -> Self {
        let next = Self::of(self.number + 1, duration_s, rate);
        if next.end - next.start >= ticks {
            return next;
        }
        // A too short repeat lacks exactly one tick, so the sum equals `count * (ticks - 1)` until one is long enough.
        let short =
            |count: u64| begin(next.number + count, duration_s, rate) - next.start < count * (ticks - 1) + 1;
        let (mut enough, mut too_few) = (2, 1);
        while short(enough) && begin(next.number + enough, duration_s, rate) < play_end {
            (enough, too_few) = (2 * enough, enough);
        }
        while too_few + 1 < enough {
            let middle = u64::midpoint(too_few, enough);
            if short(middle) { too_few = middle } else { enough = middle }
        }
        Self::of(next.number + too_few, duration_s, rate)
    }
}

/// When repeat `number` begins: `floor(number * duration_s * tick_hz + 0.5)`.
fn begin(number: u64, duration_s: Option<f64>, rate: TickRate) -> u64 {
    duration_s.map_or(0, |duration_s| rate.seconds_to_ticks(number as f64 * duration_s))
}
