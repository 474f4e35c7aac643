//! Whether a play keeps the controller's limits, from its compiled strokes: pushing a lower stop, motors that have pulses at once, and
//! moves that begin within a short time.
//!
//! A play that passes has no move refused for its plan. The time of each check grows with the moves: do not call one in the streamer's
//! thread.
//!
//! Invariant: of a play with an end, the first [`MAX_STEPS`] steps count, but no more than are found with [`MAX_WORK`]; of a play without end,
//! those of its first minute. [`Hold::counted_until`] says how far that is.

mod at_once;
mod density;
mod hold;
mod pushing;
mod vibration;

pub use at_once::find_too_many;
pub use density::{Dense, find_dense};
pub use hold::{Hold, find_longest_hold};
pub use pushing::{Overpush, find_overpush};
pub use vibration::STILL_MS;

use firmware_protocol::tick::Tick;
use meissner_array::strokes::{MAX_WORK, Step, Strokes};

/// Length of a play without end that counts, s: after a minute few plays do anything new. Drives whose frequencies differ by less than
/// 1/60 Hz meet later; then the controller refuses strokes.
const COUNTED_S: u64 = 60;
/// Steps of a play that count, at most: 23 minutes of the paper's motors at 60 Hz, three of waveforms on all of them.
const MAX_STEPS: usize = 2_000_000;

/// The steps that count, in ticks from the onset.
fn counted(strokes: &Strokes) -> Counted {
    let mut strokes = strokes.clone();
    strokes.begin(Tick(0));
    let until = strokes.end().unwrap_or(COUNTED_S * strokes.array().rate().per_s());
    Counted { strokes, until, steps: 0, stopped: None }
}

/// See [`counted`].
struct Counted {
    strokes: Strokes,
    /// Steps from this tick on do not count.
    until: u64,
    steps: usize,
    /// The beginning of the last step that counts, if more would follow.
    stopped: Option<Tick>,
}

impl Counted {
    /// After the last step that counts: from when to when steps do not count, if there may be any. An endless play has no end.
    fn uncounted(&self) -> Option<(u64, u64)> {
        let until = self.strokes.end().unwrap_or(u64::MAX);
        let from = self.stopped.map(|stopped| stopped.0);
        from.or((until == u64::MAX).then_some(self.until)).map(|from| (from, until))
    }
}

impl Iterator for Counted {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        if self.stopped.is_some() {
            return None;
        }
        let step = self.strokes.next()?.ok().filter(|step| step.begin().0 < self.until)?;
        self.steps += 1;
        let is_enough = self.steps == MAX_STEPS || self.strokes.work() >= MAX_WORK;
        self.stopped = (is_enough && !self.strokes.is_over()).then(|| step.begin());
        Some(step)
    }
}
