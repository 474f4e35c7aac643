//! What each drive of a pattern reaches in a play: its amplitude, surplus, number of strokes and end.
//!
//! Strokes are counted by their numbers, so the time does not depend on how long the play is.
//!
//! Invariant: the counts are those of the strokes that [`Strokes`](super::Strokes) returns.

use super::drive::{DriveStrokes, NEVER};
use super::error::StrokesError;
use super::options::{Fit, StrokeOptions};
use super::repeat::Repeat;
use crate::motor::SteadyState;
use crate::pattern::{Drive, Motion, Pattern};
use crate::spec::Array;
use crate::units::TickRate;

/// A motion below this counts as none, µm: seven pulses.
const LEAST_UM: f64 = 1.0;
/// The least share of the ordered amplitude that a drive must reach.
const LEAST_SHARE: f64 = 0.8;

/// What a drive reaches in a play.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reached {
    /// The array of its motor.
    pub array: Array,
    /// The drive, counted from 1.
    pub drive: usize,
    /// Its settings.
    pub settings: Drive,
    /// Amplitude as ordered, with the scale of the play, peak to peak, µm.
    pub ordered_um: f64,
    /// Amplitude that an ideal motor reaches in the steady state, peak to peak, µm; 0 without a stroke.
    pub reached_um: f64,
    /// Amplitude of its first stroke in whole pulses, µm; below the ordered one if both bursts do not fit into a period. 0: the
    /// drive does not move its pin.
    pub amplitude_um: f64,
    /// By how much its first down burst is longer than its first up burst, µm.
    pub surplus_um: f64,
    /// Strokes that it plays; `None`: without end.
    pub strokes: Option<u64>,
    /// When the last of them has ended, ticks from the onset; `None`: without end, or without strokes.
    pub over: Option<u64>,
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
pub fn motions_over(pattern: &Pattern, options: &StrokeOptions) -> Option<u64> {
    let rate = pattern.array().rate();
    let begin = pattern.motions().iter().map(Motion::start_s).reduce(f64::min)?;
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
    let array = pattern.array();
    let drives = pattern.drives().iter().zip(played(pattern, options)?).zip(1..);
    let of_drive = |((settings, Played { strokes, parts }), drive): ((&Drive, Played), usize)| {
        let first = strokes.number(0);
        let um = |pulses| if first.pulses > 0 { f64::from(pulses) * array.motor().um_per_pulse } else { 0.0 };
        let amplitude_um = um(first.pulses);
        let count = parts.map(|parts| parts.iter().map(|part| part.repeats * part.strokes).sum());
        let with_strokes = parts.into_iter().flatten().filter(|part| part.repeats > 0 && part.strokes > 0);
        let over = with_strokes.map(|part| part.last + strokes.number(part.strokes - 1).end()).max();
        let steady_um = if count == Some(0) { 0.0 } else { amplitude_um };
        let reached_um = SteadyState::ideal_um(array, settings.frequency_hz, steady_um)
            .map_err(|source| StrokesError::Drive { motor: settings.motor, source })?;
        let (ordered_um, surplus_um) = (settings.amplitude_um * options.scale, um(first.surplus));
        let (settings, strokes) = (*settings, count);
        Ok(Reached {
            array,
            drive,
            settings,
            ordered_um,
            reached_um,
            amplitude_um,
            surplus_um,
            strokes,
            over,
        })
    };
    drives.map(of_drive).collect()
}

impl Reached {
    /// How the drive falls short of its pattern, and what to do; `None`: it does not. A drive of amplitude 0 is off on purpose.
    pub fn shortfall(&self) -> Option<String> {
        let Self { drive, settings, ordered_um, reached_um, .. } = self;
        let (Drive { motor, frequency_hz, .. }, um_per_pulse) = (settings, self.array.motor().um_per_pulse);
        let what = match self.strokes {
            _ if settings.amplitude_um == 0.0 => return None,
            Some(0) if *ordered_um < um_per_pulse / 2.0 => {
                format!("gives no stroke: {ordered_um} um is less than half a pulse; raise its amplitude")
            }
            Some(0) => format!(
                "gives no stroke: none at {frequency_hz} Hz is over before the drive or the play ends; let it last longer, or raise \
                 frequency_hz"
            ),
            _ if *reached_um < LEAST_UM => {
                format!("moves its pin by {reached_um:.2} um only; raise its amplitude")
            }
            _ if *reached_um >= LEAST_SHARE * ordered_um => return None,
            _ => {
                // Rounding to whole pulses changes the amplitude by less than this.
                let saturated = self.amplitude_um < ordered_um - um_per_pulse;
                format!(
                    "{} {reached_um:.1} of {ordered_um} um ({:.0} %) at {frequency_hz} Hz; lower frequency_hz or its amplitude",
                    if saturated { "is saturated: it reaches" } else { "reaches" },
                    100.0 * reached_um / ordered_um
                )
            }
        };
        Some(format!("drive {drive} (motor {motor}) {what}"))
    }
}

/// The strokes of a drive in a play that ends at `end`: in whole repeats that last so many ticks, in those that last one more,
/// and in the last repeat.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_shortfall_is_named_with_its_drive() {
        let drive = |motor, frequency_hz, amplitude_um, stop_s| Drive {
            motor,
            frequency_hz,
            amplitude_um,
            phase: 0.0,
            start_s: None,
            stop_s,
        };
        let drives = vec![
            drive(0, 60.0, 80.0, None),
            drive(1, 60.0, 0.05, None),
            drive(2, 60.0, 80.0, Some(0.01)),
            drive(3, 60.0, 0.9, None),
            drive(4, 300.0, 80.0, None),
            drive(5, 60.0, 0.0, None),
        ];
        let pattern = Pattern::new(Array::paper(), "test", Some(1.0), drives, toml::Table::new()).unwrap();
        let lines = |options| {
            let found = reached(&pattern, &options).unwrap().into_iter();
            found.map(|drive| drive.shortfall().unwrap_or_default()).collect::<Vec<_>>()
        };
        for (line, says) in lines(StrokeOptions::default()).iter().zip([
            "",
            "drive 2 (motor 1) gives no stroke: 0.05 um is less than half a pulse; raise",
            "drive 3 (motor 2) gives no stroke: none at 60 Hz is over before",
            "drive 4 (motor 3) moves its pin by 0.",
            "drive 5 (motor 4) is saturated: it reaches ",
            "",
        ]) {
            assert!(line.starts_with(says) && line.is_empty() == says.is_empty(), "{line}");
        }
        // A scale lowers the ordered amplitude.
        let scaled = lines(StrokeOptions { scale: 0.01, ..StrokeOptions::default() });
        assert!([0, 4].iter().all(|drive| scaled[*drive].contains("moves its pin by 0.")), "{scaled:?}");
    }
}
