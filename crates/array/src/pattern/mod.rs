//! Patterns: the files that the library holds, `play` plays and `optimise` writes.
//!
//! A pattern has a name, perhaps a duration, square-wave drives of motors, motions of motors, and a free table that says
//! what made it. [`Pattern::parse`] reads its TOML file and [`Pattern::to_toml`] writes it, without comments; the API shows the same
//! keys as JSON. [`strokes`](crate::strokes) compiles the drives to strokes and the motions to moves.
//!
//! A pattern is complete in itself: samples are in its text. [`Pattern::parse_with_files`] reads one whose waves name files.
//!
//! A pattern is for an array, whose name it holds; without one it is for the paper's.
//!
//! `start_s` and `stop_s` of a drive are optional: without `start_s` the drive begins with the pattern, without
//! `stop_s` it ends with it. Neither may lie beyond the duration.
//!
//! Invariant: a [`Pattern`] has been checked; every number in it is within its range.

mod drive;
mod error;
mod file;
mod limits;
mod motion;
mod motions;
mod provenance;
mod tables;

pub use drive::{Drive, overlap};
pub use error::{PatternError, Problem};
pub use limits::{
    FORMAT, FREQUENCY_HZ, MAX_AT_ONCE, MAX_DRIVES, MAX_FILE_BYTES, MAX_HOLD_S, MAX_MOTIONS, MAX_PACKED_BYTES,
    MAX_PATTERN_SAMPLES, MAX_PROVENANCE_DEPTH, MAX_PROVENANCE_TABLES, MAX_PROVENANCE_TEXT,
    MAX_PROVENANCE_VALUES, MAX_SAMPLE_FILE_BYTES, MAX_SECONDS, MAX_SOURCE,
};
pub use motion::{Motion, Wave};
pub use tables::Files;

use crate::motion::{SLOWEST_STEP_MS, Waveform, s_of};
use crate::spec::Array;
use error::KeyError;
use meissner_input::document::in_range;
use meissner_input::message::quote;
use serde::Serialize;
use std::sync::Arc;

/// A checked pattern.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pattern {
    format: u8,
    name: String,
    #[serde(skip_serializing_if = "is_default")]
    array: Array,
    #[serde(skip_serializing_if = "Option::is_none")]
    duration_s: Option<f64>,
    #[serde(rename = "drive", skip_serializing_if = "Vec::is_empty")]
    drives: Vec<Drive>,
    /// In the order of a file: waves, ramps, tones, noise.
    #[serde(flatten, serialize_with = "tables::write")]
    motions: Arc<[Motion]>,
    /// The sum of each motor's motions, in order of motors.
    #[serde(skip)]
    waveforms: Arc<[(u8, Waveform)]>,
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    provenance: toml::Table,
}

impl Pattern {
    /// Makes a pattern for an array. `provenance` says what made it: target, seed, setting, method and so on.
    ///
    /// # Errors
    /// The first problem, with the pattern's name in place of a file's.
    pub fn new(
        array: Array,
        name: &str,
        duration_s: Option<f64>,
        drives: Vec<Drive>,
        provenance: toml::Table,
    ) -> Result<Self, PatternError> {
        let (format, motions, waveforms) = (FORMAT, [].into(), [].into());
        let owned = name.to_owned();
        let pattern = Self { format, name: owned, array, duration_s, drives, motions, waveforms, provenance };
        pattern.checked().map_err(|error| PatternError(error.in_file(Some(name))))
    }

    /// The pattern with these motions in place of its own.
    ///
    /// # Errors
    /// The first problem, with the pattern's name in place of a file's.
    pub fn with_motions(self, mut motions: Vec<Motion>) -> Result<Self, PatternError> {
        motions.sort_by_key(Motion::kind);
        let name = self.name.clone();
        let pattern = Self { motions: motions.into(), ..self };
        pattern.checked().map_err(|error| PatternError(error.in_file(Some(&name))))
    }

    /// The pattern as a file, which [`Self::parse`] reads back as the same pattern.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a pattern is tables of strings and numbers")
    }

    /// Its name: 1 to 64 of a-z, 0-9 and -.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The array that it is for.
    pub const fn array(&self) -> Array {
        self.array
    }

    /// How long one repeat lasts, s; without it the pattern is endless.
    pub const fn duration_s(&self) -> Option<f64> {
        self.duration_s
    }

    /// Its drives, in the order of the file.
    pub fn drives(&self) -> &[Drive] {
        &self.drives
    }

    /// Its motions, in the order of a file: waves, ramps, tones, noise.
    pub fn motions(&self) -> &[Motion] {
        &self.motions
    }

    /// The waveform of each motor that has a motion: the sum of its motions, in order of motors. It is within the motor's travel.
    pub fn waveforms(&self) -> &[(u8, Waveform)] {
        &self.waveforms
    }

    /// The largest amplitude that a drive asks for, or the largest height that a motion asks for, µm.
    pub fn largest_um(&self) -> f64 {
        self.largest_reached_um(|_| 1.0)
    }

    /// [`Self::largest_um`] with pins that go so many times as far as asked.
    pub fn largest_reached_um(&self, reach: impl Fn(u8) -> f64) -> f64 {
        let drives = self.drives.iter().map(|drive| drive.amplitude_um * reach(drive.motor));
        let heights =
            self.waveforms.iter().map(|(motor, waveform)| waveform.extremes_um()[1] * reach(*motor));
        drives.chain(heights).fold(0.0, f64::max)
    }

    /// Bytes of the samples and knots of its motions, in memory.
    pub fn motion_bytes(&self) -> usize {
        let samples = self.motions.iter().map(|motion| match motion {
            Motion::Wave(wave) => size_of_val(&*wave.um),
            _ => 0,
        });
        samples.sum::<usize>()
            + self.waveforms.iter().map(|(_, waveform)| waveform.own_bytes()).sum::<usize>()
    }

    /// [`Self::waveforms`], shared.
    pub(crate) fn shared_waveforms(&self) -> Arc<[(u8, Waveform)]> {
        self.waveforms.clone()
    }

    /// When all pins with motions are at rest again, s: a motor comes down from where its last motion ends.
    pub fn motions_rest_s(&self) -> f64 {
        let (motor, rate) = (self.array.motor(), self.array.rate());
        let steps_s = 2.0 * SLOWEST_STEP_MS as f64 / 1000.0;
        let rests = self.waveforms.iter().filter_map(|(_, waveform)| {
            let (_, until) = waveform.span_ns()?;
            let pulses = motor.pulses(waveform.um_around(until)[0]).ceil();
            let down_s = if pulses > 0.0 { pulses / f64::from(rate.hz()) + steps_s } else { 0.0 };
            Some(s_of(until) + down_s)
        });
        rests.fold(0.0, f64::max)
    }

    /// What made the pattern.
    pub const fn provenance(&self) -> &toml::Table {
        &self.provenance
    }

    /// The drives that saturate, counted from 1, and a line for each: allowed, but perhaps not intended. Such an amplitude does not
    /// fit into half a period, so the drive plays with a smaller one.
    pub fn saturated(&self) -> impl Iterator<Item = (usize, String)> {
        self.drives.iter().zip(1..).filter_map(|(settings, drive)| {
            let (wave, Drive { motor, amplitude_um, frequency_hz, .. }) =
                (settings.wave(self.array).ok()?, settings);
            let (wanted, fit) = (wave.wanted_pulses(), wave.pulses());
            let um = f64::from(fit) * self.array.motor().um_per_pulse;
            let line = || {
                format!(
                    "drive {drive} (motor {motor}) is saturated: {amplitude_um} um at {frequency_hz} Hz wants {wanted} \
                     pulses each way, {fit} fit ({um:.1} um); lower frequency_hz or amplitude_um"
                )
            };
            (fit < wanted).then(|| (drive, line()))
        })
    }

    /// The pattern with its waveforms, if it is sound.
    fn checked(mut self) -> Result<Self, KeyError> {
        self.check()?;
        self.waveforms = motions::waveforms(self.array, self.duration_s, &self.drives, &self.motions)?.into();
        Ok(self)
    }

    fn check(&self) -> Result<(), KeyError> {
        if !is_name(&self.name) {
            return Err(KeyError::key("name", Problem::Name { found: quote(&self.name) }));
        }
        if let Some(found) = self.duration_s {
            // A step of the coarsest grid has no more than one seam.
            let least_s = if self.motions.is_empty() { 0.0 } else { SLOWEST_STEP_MS as f64 / 1000.0 };
            let good =
                (least_s..=MAX_SECONDS).contains(&found) && self.array.rate().seconds_to_ticks(found) > 0;
            let least = if self.motions.is_empty() {
                format!("one tick (1/{} s)", self.array.rate().hz())
            } else {
                format!("{least_s} s with motions")
            };
            let range = format!("at least {least} and at most 100000000 s");
            in_range("duration_s", found, good, range)?;
        }
        if self.drives.len() > MAX_DRIVES {
            return Err(KeyError::key("drive", Problem::TooManyDrives { count: self.drives.len() }));
        }
        for (index, drive) in self.drives.iter().enumerate() {
            drive
                .check(self.array, self.duration_s)
                .map_err(|error| error.within(&format!("drive[{index}]")))?;
        }
        provenance::check(&self.provenance).map_err(|problem| KeyError::key("provenance", problem))?;
        if let Some((first, second)) = overlap(&self.drives) {
            let Drive { motor, .. } = self.drives[second];
            let problem = Problem::Overlap { motor, other: first + 1, start_s: self.drives[second].start() };
            return Err(KeyError::key(&format!("drive[{second}].motor"), problem));
        }
        Ok(())
    }
}

/// Whether it is the array of patterns that name none.
fn is_default(array: &Array) -> bool {
    *array == Array::paper()
}

/// Whether `name` is a valid name of a pattern or a target: 1 to 64 of a-z, 0-9 and -.
pub fn is_name(name: &str) -> bool {
    let letter = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-';
    (1..=64).contains(&name.len()) && name.bytes().all(letter)
}

/// Whether a new pattern or target may have this name. Older ones may begin with `-`, which a command line takes for stdin or an option.
pub fn is_new_name(name: &str) -> bool {
    is_name(name) && !name.starts_with('-')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(motor: u8, start_s: Option<f64>, stop_s: Option<f64>) -> Drive {
        Drive { motor, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.0, start_s, stop_s }
    }

    fn pattern(drives: Vec<Drive>) -> Result<Pattern, PatternError> {
        Pattern::new(Array::paper(), "test", Some(2.0), drives, toml::Table::new())
    }

    #[test]
    fn drives_of_one_motor_may_follow_each_other_but_not_overlap() {
        pattern(vec![drive(3, Some(1.0), None), drive(3, None, Some(1.0)), drive(4, None, None)]).unwrap();
        let line = pattern(vec![drive(3, Some(1.0), None), drive(3, None, None)]).unwrap_err().to_string();
        assert!(line.starts_with("test: drive 1: ") && line.contains("drive 2"), "{line}");
    }

    #[test]
    fn a_saturated_drive_is_warned_of_with_figures() {
        let fast = Drive { frequency_hz: 300.0, ..drive(9, None, None) };
        let pattern = pattern(vec![drive(8, None, None), fast]).unwrap();
        let line = "drive 2 (motor 9) is saturated: 80 um at 300 Hz wants 589 pulses each way, 141 fit (19.1 um); \
                    lower frequency_hz or amplitude_um";
        assert_eq!(pattern.saturated().collect::<Vec<_>>(), [(2, line.to_owned())]);
    }
}
