//! Whether a play keeps the controller's limits, from its compiled strokes: pushing a lower stop, motors that have pulses at once, and
//! strokes that begin within a short time.
//!
//! A play that passes has no stroke refused for its plan. The time of each check grows with the strokes: do not call one in the streamer's
//! thread.
//!
//! Invariant: of a play with an end, the first [`MAX_STROKES`] strokes count; of a play without end, those of its first minute.

mod at_once;
mod density;
mod pushing;

pub use at_once::find_too_many;
pub use density::{Dense, find_dense};
pub use pushing::{Overpush, find_overpush};

use firmware_protocol::tick::Tick;
use meissner_array::strokes::Stroke;
use meissner_array::strokes::Strokes;

/// Length of a play without end that counts, s: after a minute few plays do anything new. Drives whose frequencies differ by less than
/// 1/60 Hz meet later; then the controller refuses strokes.
const COUNTED_S: u64 = 60;
/// Strokes of a play that count, at most: 23 minutes of the paper's motors at 60 Hz.
const MAX_STROKES: usize = 2_000_000;

/// The strokes that count, in ticks from the onset.
fn counted(strokes: &Strokes) -> impl Iterator<Item = Stroke> {
    let mut strokes = strokes.clone();
    strokes.begin(Tick(0));
    let until = strokes.end().unwrap_or(COUNTED_S * strokes.array().rate().per_s());
    strokes.map_while(Result::ok).take(MAX_STROKES).take_while(move |stroke| stroke.up.0 < until)
}
