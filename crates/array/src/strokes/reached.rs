//! What each drive of a pattern reaches in a play: its amplitude, its surplus, and how many strokes it plays.
//!
//! Strokes are counted by their numbers, so the time does not depend on how long the play is.
//!
//! Invariant: the counts are those of the strokes that [`Strokes`](super::Strokes) returns.

use super::drive::{DriveStrokes, NEVER};
use super::error::StrokesError;
use super::options::{Fit, StrokeOptions};
use super::repeat::Repeat;
use crate::pattern::Pattern;
use crate::units::{UM_PER_PULSE, seconds_in_ticks};

/// What a drive reaches in a play.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reached {
    /// Amplitude of its first stroke in whole pulses, µm; below the drive's own if both bursts do not fit into a period, or if
    /// the play is scaled. 0: the drive does not move its pin.
    pub amplitude_um: f64,
    /// By how much its first down burst is longer than its first up burst, µm.
    pub surplus_um: f64,
    /// Strokes that it plays; `None`: without end.
    pub strokes: Option<u64>,
}

/// What each drive of a pattern reaches, in the order of the pattern.
///
/// # Errors
/// If an option is outside its range.
pub fn reached(pattern: &Pattern, options: &StrokeOptions) -> Result<Vec<Reached>, StrokesError> {
    options.check()?;
    let end = super::end(pattern, options.seconds);
    let drives = pattern.drives().iter().map(|drive| {
        let strokes = DriveStrokes::with(drive, options)
            .map_err(|source| StrokesError::Drive { motor: drive.motor, source })?;
        let count = if strokes.clone().next().is_none() {
            Some(0)
        } else {
            end.map(|end| count(&strokes, pattern.duration_s(), end, options.fit))
                .or_else(|| drive.stop_s.map(|_| strokes.begun_before(NEVER)))
        };
        let first = strokes.number(0);
        let um = |pulses| f64::from(pulses) * UM_PER_PULSE;
        let (amplitude_um, surplus_um) =
            if first.pulses > 0 { (um(first.pulses), um(first.surplus)) } else { (0.0, 0.0) };
        Ok(Reached { amplitude_um, surplus_um, strokes: count })
    });
    drives.collect()
}

/// The strokes of a drive in a play that ends at `end`. Whole repeats last so many ticks or one more.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast is the floor of a checked duration"
)]
fn count(strokes: &DriveStrokes, duration_s: Option<f64>, end: u64, fit: Fit) -> u64 {
    let last = Repeat::last(duration_s, end);
    let short = duration_s.map_or(0, |duration_s| seconds_in_ticks(duration_s) as u64);
    let longer = last.start.saturating_sub(last.number * short).min(last.number);
    let in_repeat = |ticks| strokes.shifted(0, ticks).begun_before(NEVER);
    let in_last = match fit {
        Fit::Whole => in_repeat(last.end.min(end) - last.start.min(end)),
        Fit::Cover => strokes.begun_before(end - last.start.min(end)),
    };
    let whole = |repeats: u64, ticks| if repeats > 0 { repeats * in_repeat(ticks) } else { 0 };
    whole(last.number - longer, short) + whole(longer, short + 1) + in_last
}
