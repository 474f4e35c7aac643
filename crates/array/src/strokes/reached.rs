//! What each drive of a pattern reaches in a play: its amplitude, surplus, number of strokes and end; and the strokes and pulses of
//! the whole play.
//!
//! Strokes are counted by their numbers, so the time does not depend on how long the play is. The pulses of a saturated drive
//! differ from stroke to stroke, so [`ordered`] iterates over its strokes, up to a limit.
//!
//! Invariant: the counts are those of the strokes that [`Strokes`](super::Strokes) returns.

use super::drive::{DriveStrokes, NEVER};
use super::error::StrokesError;
use super::options::{Fit, StrokeOptions};
use super::repeat::Repeat;
use crate::pattern::Pattern;
use crate::units::TickRate;

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
    /// When the last of them has ended, ticks from the onset; `None`: without end, or without strokes.
    pub over: Option<u64>,
}

/// The number of strokes and pulses of a play.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ordered {
    /// Strokes of all drives.
    pub strokes: u64,
    /// Pulses of their bursts; `None` if counting them would take too many strokes.
    pub pulses: Option<u64>,
}

/// The number of strokes and pulses of a play; `None` if it has no end. Iterates over at most `walked` strokes of saturated drives,
/// all drives together: a million takes 30 ms.
///
/// # Errors
/// If an option is outside its range.
pub fn ordered(
    pattern: &Pattern,
    options: &StrokeOptions,
    walked: u64,
) -> Result<Option<Ordered>, StrokesError> {
    let mut ordered = Ordered { strokes: 0, pulses: Some(0) };
    let mut budget = walked;
    for played in played(pattern, options)? {
        let Some(parts) = played.parts else { return Ok(None) };
        for Part { repeats, strokes, .. } in parts {
            ordered.strokes += repeats * strokes;
            let pulses = if repeats == 0 { Some(0) } else { played.strokes.pulses_of(strokes, &mut budget) };
            ordered.pulses = ordered.pulses.zip(pulses).map(|(sum, pulses)| sum + repeats * pulses);
        }
    }
    Ok(Some(ordered))
}

/// The strokes of a drive in a play.
struct Played {
    strokes: DriveStrokes,
    /// The repeats, in three kinds; `None`: without end.
    parts: Option<[Part; 3]>,
}

/// Repeats in which a drive plays the same number of strokes.
#[derive(Clone, Copy, Default)]
struct Part {
    repeats: u64,
    /// Strokes in each.
    strokes: u64,
    /// When the last of them begins.
    last: u64,
}

/// The strokes of each drive, in the order of the pattern.
fn played(pattern: &Pattern, options: &StrokeOptions) -> Result<Vec<Played>, StrokesError> {
    let array = pattern.array();
    options.check(array)?;
    let end = super::ordered_end(pattern, options.seconds);
    let drives = pattern.drives().iter().map(|drive| {
        let strokes = DriveStrokes::with(array, drive, options)
            .map_err(|source| StrokesError::Drive { motor: drive.motor, source })?;
        let parts = if strokes.clone().next().is_none() {
            Some([Part::default(); 3])
        } else if let Some(end) = end {
            Some(parts(&strokes, array.rate(), pattern.duration_s(), end, options.fit))
        } else {
            let only = || Part { repeats: 1, strokes: strokes.begun_before(NEVER), last: 0 };
            drive.stop_s.map(|_| [Part::default(), Part::default(), only()])
        };
        Ok(Played { strokes, parts })
    });
    drives.collect()
}

/// When the motions of a play are over, ticks from the onset, to a step of their grid; `None` without motions, or without end.
#[must_use]
pub fn motions_over(pattern: &Pattern, options: &StrokeOptions) -> Option<u64> {
    let rate = pattern.array().rate();
    let begin = pattern.motions().iter().map(|motion| motion.form.span_s().0).reduce(f64::min)?;
    let [begin, rest] = [begin, pattern.motions_rest_s()].map(|s| rate.seconds_to_ticks(s));
    let Some(end) = super::ordered_end(pattern, options.seconds) else {
        return pattern.duration_s().is_none().then_some(rest);
    };
    let last = Repeat::last(pattern.duration_s(), rate, end);
    let start = if last.start + begin < end || last.number == 0 {
        last.start
    } else {
        Repeat::of(last.number - 1, pattern.duration_s(), rate).start
    };
    Some((start + rest).min(end))
}

/// What each drive of a pattern reaches, in the order of the pattern.
///
/// # Errors
/// If an option is outside its range.
pub fn reached(pattern: &Pattern, options: &StrokeOptions) -> Result<Vec<Reached>, StrokesError> {
    let um_per_pulse = pattern.array().motor().um_per_pulse;
    let drives = played(pattern, options)?.into_iter().map(|Played { strokes, parts }| {
        let first = strokes.number(0);
        let um = |pulses| f64::from(pulses) * um_per_pulse;
        let (amplitude_um, surplus_um) =
            if first.pulses > 0 { (um(first.pulses), um(first.surplus)) } else { (0.0, 0.0) };
        let count = parts.map(|parts| parts.iter().map(|part| part.repeats * part.strokes).sum());
        let with_strokes = parts.into_iter().flatten().filter(|part| part.repeats > 0 && part.strokes > 0);
        let over = with_strokes.map(|part| part.last + strokes.number(part.strokes - 1).end()).max();
        Reached { amplitude_um, surplus_um, strokes: count, over }
    });
    Ok(drives.collect())
}

/// The strokes of a drive in a play that ends at `end`: in whole repeats that last so many ticks, in those that last one more,
/// and in the last repeat.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast is the floor of a checked duration"
)]
fn parts(strokes: &DriveStrokes, rate: TickRate, duration_s: Option<f64>, end: u64, fit: Fit) -> [Part; 3] {
    let last = Repeat::last(duration_s, rate, end);
    let short = duration_s.map_or(0, |duration_s| rate.seconds_in_ticks(duration_s) as u64);
    let longer_before =
        |number: u64| Repeat::of(number, duration_s, rate).start.saturating_sub(number * short).min(number);
    let longer = longer_before(last.number);
    let in_repeat = |ticks| strokes.shifted(0, ticks).begun_before(NEVER);
    let in_last = match fit {
        Fit::Whole => in_repeat(last.end.min(end) - last.start.min(end)),
        Fit::Cover => strokes.begun_before(end - last.start.min(end)),
    };
    let whole = |repeats: u64, ticks: u64, is_one: &dyn Fn(u64) -> bool| {
        if repeats == 0 {
            return Part::default();
        }
        let number = last_repeat(last.number, is_one);
        Part { repeats, strokes: in_repeat(ticks), last: Repeat::of(number, duration_s, rate).start }
    };
    [
        // `number` is at most the last repeat of this kind if fewer of the kind lie before it than before the last repeat.
        whole(last.number - longer, short, &|number| number - longer_before(number) < last.number - longer),
        whole(longer, short + 1, &|number| longer_before(number) < longer),
        Part { repeats: 1, strokes: in_last, last: last.start },
    ]
}

/// The last repeat before `end` for which a condition holds. It must hold from the first repeat up to some repeat, and for none
/// after that.
fn last_repeat(end: u64, holds: &dyn Fn(u64) -> bool) -> u64 {
    let (mut one, mut none) = (0, end);
    while one + 1 < none {
        let middle = u64::midpoint(one, none);
        if holds(middle) { one = middle } else { none = middle }
    }
    one
}
