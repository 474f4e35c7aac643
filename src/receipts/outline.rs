//! What a pattern becomes in a play in whole strokes: durations, counts, amplitudes, warnings.
//!
//! [`Outline::of`] reads a pattern with the options of a play; the store does so for one run of a pattern.
//!
//! Invariant: it describes exactly the strokes that are played, without iterating over them.

use meissner_api::{
    DurationRecord, FollowedMotion, MAX_DRIVES_LISTED, MAX_LISTED, MAX_WARNINGS_LISTED, OrderedCounts,
    ReachedDrive, Receipt,
};
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_array::strokes::{self, Followed, Reached, StrokeOptions, StrokesError};
use std::collections::BTreeMap;

/// See the module.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outline {
    /// Duration as ordered, ms; `None`: without end.
    pub ordered_ms: Option<f64>,
    /// Duration to the end of the last whole stroke, ms; `None`: without end.
    pub compiled_ms: Option<f64>,
    /// The amplitudes that the drives reach.
    pub drives: Vec<ReachedDrive>,
    /// The highest level that motions ask for, µm; 0 without motions that move a pin.
    pub motions_um: f64,
    /// One line for each drive that may not do what the pattern's author intended.
    pub warnings: Vec<String>,
}

impl Outline {
    /// The order to play a pattern with these options.
    ///
    /// # Errors
    /// If an option is outside its range.
    pub fn of(pattern: &Pattern, options: &StrokeOptions) -> Result<Self, StrokesError> {
        let (found, rate) = (strokes::reached(pattern, options)?, pattern.array().rate());
        let ends = found.iter().all(|drive| drive.strokes.is_some());
        let over = found.iter().filter_map(|drive| drive.over);
        let over = over.chain(strokes::motions_over(pattern, options)).max();
        Ok(Self {
            ordered_ms: strokes::ordered_end(pattern, options.seconds).map(|end| rate.ticks_to_ms(end)),
            compiled_ms: ends.then(|| rate.ticks_to_ms(over.unwrap_or(0))),
            drives: found.iter().map(reached).collect(),
            motions_um: motion_heights(pattern).map(|(_, um)| um).fold(0.0, f64::max) * options.scale,
            warnings: warnings(pattern, &found),
        })
    }

    /// Why nothing would be played; `None` if there is a stroke or a motion.
    pub fn empty(&self) -> Option<&str> {
        let moves = self.motions_um > 0.0 || self.drives.iter().any(|drive| drive.strokes != Some(0));
        let why = self
            .warnings
            .first()
            .map_or("every drive is off and no motion goes up: give one an amplitude", String::as_str);
        (!moves).then_some(why)
    }

    /// The largest amplitude of the drives or level of the motions as ordered, and the largest amplitude that drives reach, µm.
    pub fn largest_um(&self) -> [f64; 2] {
        let [ordered_um, reached_um] = largest_um(&self.drives);
        [ordered_um.max(self.motions_um), reached_um]
    }

    /// The first [`MAX_LISTED`] warnings, and how many more there are.
    pub fn listed_warnings(&self) -> Vec<String> {
        first(&self.warnings, MAX_LISTED)
    }

    /// Puts the order into the receipt of its play.
    pub fn enter(&self, receipt: &mut Receipt, counts: Option<OrderedCounts>) {
        let Self { ordered_ms, compiled_ms, drives, warnings, .. } = self;
        receipt.duration_ms =
            DurationRecord { ordered: *ordered_ms, compiled: *compiled_ms, ..DurationRecord::default() };
        receipt.counts.ordered = counts;
        receipt.reach.drives = drives.iter().take(MAX_DRIVES_LISTED).copied().collect();
        receipt.reach.warnings = first(warnings, MAX_WARNINGS_LISTED);
    }
}

/// The largest amplitude of drives, as ordered and as reached, µm.
pub fn largest_um(drives: &[ReachedDrive]) -> [f64; 2] {
    let most = |of: fn(&ReachedDrive) -> f64| drives.iter().map(of).fold(0.0, f64::max);
    [most(|drive| drive.ordered_um), most(|drive| drive.reached_um)]
}

/// The motors whose motions move their pin, and the highest level of each, µm.
pub fn motion_heights(pattern: &Pattern) -> impl Iterator<Item = (u8, f64)> {
    let array = pattern.array();
    let motor = array.motor();
    let least_um = motor.um_per_pulse * (f64::from(motor.least_pulses) + 1.0) / 2.0;
    let heights = pattern.waveforms().iter().map(|(motor, waveform)| (*motor, waveform.extremes_um()[1]));
    heights.filter(move |(_, um)| *um >= least_um)
}

/// How the motors of a play follow their motions.
pub fn motions(followed: &[Followed]) -> Vec<FollowedMotion> {
    let rounded = |number: f64| (number * 1000.0).round() / 1000.0;
    let motion = |found: &Followed| FollowedMotion {
        motor: found.motor,
        highest_um: rounded(found.waveform.extremes_um()[1]),
        error_um: rounded(found.reached.from_asked.rms_um),
        error_share: rounded(found.reached.from_asked.share),
        step_error_um: rounded(found.reached.step_error_um),
        too_slow_from_s: found.too_slow_from_s.map(rounded),
        moves_per_s: rounded(found.reached.moves_per_s),
        measured_s: rounded(found.measured_s),
    };
    followed.iter().map(motion).collect()
}

/// How the motors of a sequence follow their motions: of each motor the figures of the item in which it is off the most, and the first
/// instant at which it is too slow. The items come with their onsets, s.
pub fn motions_of_items<'a>(items: impl Iterator<Item = (f64, &'a [FollowedMotion])>) -> Vec<FollowedMotion> {
    let mut of_motor: BTreeMap<u8, FollowedMotion> = BTreeMap::new();
    for (onset_s, motions) in items {
        for motion in motions {
            let too_slow_from_s = motion.too_slow_from_s.map(|from_s| onset_s + from_s);
            let most = of_motor.entry(motion.motor).or_insert(FollowedMotion { too_slow_from_s, ..*motion });
            let from_s = most.too_slow_from_s.into_iter().chain(too_slow_from_s).reduce(f64::min);
            if motion.error_um > most.error_um {
                *most = *motion;
            }
            most.too_slow_from_s = from_s;
        }
    }
    of_motor.into_values().collect()
}

/// The line for a motor that is too slow for its motions.
pub fn too_slow(motion: &FollowedMotion, array: Array) -> Option<String> {
    let FollowedMotion { motor, error_um, error_share, .. } = motion;
    let (from_s, spec) = (motion.too_slow_from_s?, array.motor());
    let mm_per_s = spec.um_per_pulse * f64::from(array.rate().hz()) / 1000.0;
    Some(format!(
        "motor {motor} is too slow for its motion, first after {from_s} s: it moves {mm_per_s:.1} mm/s at most (error {error_um:.1} um \
         RMS, {:.0} %); make the motion slower or smaller",
        100.0 * error_share
    ))
}

fn reached(found: &Reached) -> ReachedDrive {
    let Reached { drive, settings, strokes, .. } = *found;
    // Round the figures: a receipt is kept for years, and the model is not more accurate.
    let [ordered_um, reached_um, surplus_um] =
        [found.ordered_um, found.reached_um, found.surplus_um].map(|um| (um * 1000.0).round() / 1000.0);
    ReachedDrive { drive, motor: settings.motor, ordered_um, reached_um, surplus_um, strokes }
}

/// A line for each drive: its shortfall, or else that it is saturated.
fn warnings(pattern: &Pattern, found: &[Reached]) -> Vec<String> {
    let mut lines: BTreeMap<usize, String> = pattern.saturated().collect();
    lines.extend(found.iter().filter_map(|drive| Some((drive.drive, drive.shortfall()?))));
    lines.into_values().collect()
}

fn first(lines: &[String], most: usize) -> Vec<String> {
    let more = lines.len().saturating_sub(most);
    let more = (more > 0).then(|| format!("{more} more drives may not do what is meant"));
    lines.iter().take(most).cloned().chain(more).collect()
}
