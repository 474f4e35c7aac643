//! Whether a play keeps the controller's limits, from its compiled strokes: pushing a lower stop, motors that have pulses at once, and
//! moves that begin within a short time.
//!
//! A play that passes has no move refused for its plan. The time of each check grows with the moves: do not call one in the streamer's
//! thread.
//!
//! Invariant: of a play with an end, the first [`MAX_STEPS`] steps count; of a play without end, those of its first minute.

mod at_once;
mod density;
mod hold;
mod pushing;

pub use at_once::find_too_many;
pub use density::{Dense, find_dense};
pub use hold::find_longest_hold;
pub use pushing::{Overpush, find_overpush};

use firmware_protocol::tick::Tick;
use meissner_array::strokes::{Step, Strokes};

/// Length of a play without end that counts, s: after a minute few plays do anything new. Drives whose frequencies differ by less than
/// 1/60 Hz meet later; then the controller refuses strokes.
const COUNTED_S: u64 = 60;
/// Steps of a play that count, at most: 23 minutes of the paper's motors at 60 Hz, three of waveforms on all of them.
const MAX_STEPS: usize = 2_000_000;

/// The steps that count, in ticks from the onset.
fn counted(strokes: &Strokes) -> impl Iterator<Item = Step> {
    let mut strokes = strokes.clone();
    strokes.begin(Tick(0));
    let until = strokes.end().unwrap_or(COUNTED_S * strokes.array().rate().per_s());
    strokes.map_while(Result::ok).take(MAX_STEPS).take_while(move |step| step.begin().0 < until)
}
