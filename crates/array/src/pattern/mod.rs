//! Patterns: what the library holds, `play` names and the optimiser writes.
//!
//! A pattern is a name, perhaps a duration, square-wave drives of motors, and a free table that says what made
//! it. Its file is TOML (`file` reads it, [`Pattern::to_toml`] writes it, without comments); the API
//! shows the same shape as JSON. When drives become strokes, and what strokes they are, is `strokes`' business.
//!
//! `start_s` and `stop_s` are each optional: a drive without `start_s` begins with the pattern, one without
//! `stop_s` ends with it. Neither may lie beyond the duration: the file would contradict itself.
//!
//! Invariant: a [`Pattern`] that exists has been checked; every number in it is within its range.

mod error;
mod file;

pub use error::{PatternError, Problem};

use crate::motor::{MotorError, SquareWave};
use crate::units::{UM_PER_PULSE, seconds_to_ticks};
use error::Fault;
use firmware_protocol::stroke::MOTORS;
use meissner_input::document::in_range;
use meissner_input::message::quote;
use serde::Serialize;
use std::fmt;

/// The version of the file format this program reads and writes.
pub const FORMAT: u8 = 1;
/// Drives of one pattern at the most: 170 in turn on every motor.
pub const MAX_DRIVES: usize = 4096;
/// Bytes of a pattern file at the most; [`MAX_DRIVES`] written out take less.
pub const MAX_FILE_BYTES: usize = 1 << 20;
/// The latest time in a pattern, s: three years, far below where `f64` seconds no longer tell ticks apart.
pub const MAX_SECONDS: f64 = 1e8;
/// Frequencies of a drive, Hz: the paper's motors vibrate up to 300 Hz.
pub const FREQUENCY_HZ: std::ops::RangeInclusive<f64> = 0.1..=300.0;
/// Amplitudes of a drive, µm peak to peak: they stay below the controller's limit of 3 000 pulses.
pub const AMPLITUDE_UM: std::ops::RangeInclusive<f64> = 0.0..=400.0;

/// A square wave on one motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Drive {
    /// 0..24, `4 * row + column`.
    pub motor: u8,
    /// Within [`FREQUENCY_HZ`].
    pub frequency_hz: f64,
    /// Peak to peak, within [`AMPLITUDE_UM`]; 0 is off.
    pub amplitude_um: f64,
    /// Cycles by which the first upward edge comes after the start, in [0, 1).
    pub phase: f64,
    /// Pattern time of the drive's own time 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_s: Option<f64>,
    /// Pattern time by which its last stroke has ended.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stop_s: Option<f64>,
}

impl Drive {
    /// The drive's wave, counted from its start.
    ///
    /// # Errors
    /// If a number is out of the motor's range, which in a checked pattern none is.
    pub fn wave(&self) -> Result<SquareWave, MotorError> {
        SquareWave::new(self.frequency_hz, self.amplitude_um, self.phase)
    }

    /// When its own time 0 is.
    pub fn start(&self) -> f64 {
        self.start_s.unwrap_or(0.0)
    }

    fn check(&self, duration_s: Option<f64>) -> Result<(), Fault> {
        in_range("motor", self.motor.into(), usize::from(self.motor) < MOTORS, "0 to 23")?;
        let hz = self.frequency_hz;
        in_range("frequency_hz", hz, FREQUENCY_HZ.contains(&hz), "0.1 to 300 Hz")?;
        let um = self.amplitude_um;
        in_range("amplitude_um", um, AMPLITUDE_UM.contains(&um), "0 to 400 um")?;
        in_range("phase", self.phase, (0.0..1.0).contains(&self.phase), "at least 0 and below 1")?;
        for (key, time) in [("start_s", self.start_s), ("stop_s", self.stop_s)] {
            let Some(found) = time else { continue };
            in_range(key, found, (0.0..=MAX_SECONDS).contains(&found), "0 to 100000000 s")?;
            // A drive may end with the pattern but not begin there.
            if let Some(duration_s) = duration_s
                && (found > duration_s || (key == "start_s" && found >= duration_s))
            {
                return Err(Fault::key(key, Problem::BeyondDuration { found, duration_s }));
            }
        }
        match self.stop_s {
            Some(stop_s) if stop_s <= self.start() => {
                Err(Fault::key("stop_s", Problem::StopsBeforeStart { start_s: self.start(), stop_s }))
            }
            _ => Ok(()),
        }
    }
}

/// A checked pattern.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pattern {
    format: u8,
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    duration_s: Option<f64>,
    #[serde(rename = "drive", skip_serializing_if = "Vec::is_empty")]
    drives: Vec<Drive>,
    #[serde(skip_serializing_if = "toml::Table::is_empty")]
    provenance: toml::Table,
}

impl Pattern {
    /// Makes a pattern of its parts. `provenance` says what made it: target, seed, setting, method and so on.
    ///
    /// # Errors
    /// The first thing that is wrong with it, under its name in place of a file's.
    pub fn new(
        name: &str,
        duration_s: Option<f64>,
        drives: Vec<Drive>,
        provenance: toml::Table,
    ) -> Result<Self, PatternError> {
        let pattern = Self { format: FORMAT, name: name.to_owned(), duration_s, drives, provenance };
        pattern.check().map_err(|fault| PatternError(fault.placed(Some(name))))?;
        Ok(pattern)
    }

    /// Reads a pattern file; `file` is what errors call it.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn parse(text: &str, file: &str) -> Result<Self, PatternError> {
        file::parse(text, file)
    }

    /// The pattern as a file, which [`Self::parse`] reads back as the same pattern.
    #[must_use]
    #[expect(clippy::missing_panics_doc, reason = "it does not happen")]
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a pattern is tables of strings and numbers")
    }

    /// Its name: 1 to 64 of a-z, 0-9 and -.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How long one run lasts; without it the pattern is endless.
    #[must_use]
    pub const fn duration_s(&self) -> Option<f64> {
        self.duration_s
    }

    /// Its drives, as the file has them.
    #[must_use]
    pub fn drives(&self) -> &[Drive] {
        &self.drives
    }

    /// What made it.
    #[must_use]
    pub const fn provenance(&self) -> &toml::Table {
        &self.provenance
    }

    /// What is allowed but may not be what was meant: drives that saturate.
    #[must_use]
    pub fn warnings(&self) -> Vec<Warning> {
        let warning = |(index, drive): (usize, &Drive)| {
            let wave = drive.wave().ok()?;
            let (wanted_pulses, reachable_pulses) = (wave.wanted_pulses(), wave.pulses());
            (reachable_pulses < wanted_pulses).then_some(Warning {
                drive: index + 1,
                settings: *drive,
                wanted_pulses,
                reachable_pulses,
            })
        };
        self.drives.iter().enumerate().filter_map(warning).collect()
    }

    fn check(&self) -> Result<(), Fault> {
        if !is_name(&self.name) {
            return Err(Fault::key("name", Problem::Name { found: quote(&self.name) }));
        }
        if let Some(found) = self.duration_s {
            let good = found <= MAX_SECONDS && seconds_to_ticks(found) > 0;
            let range = "at least one tick (1/85000 s) and at most 100000000 s";
            in_range("duration_s", found, good, range)?;
        }
        if self.drives.len() > MAX_DRIVES {
            return Err(Fault::key("drive", Problem::TooManyDrives { count: self.drives.len() }));
        }
        for (index, drive) in self.drives.iter().enumerate() {
            drive.check(self.duration_s).map_err(|fault| fault.within(&format!("drive[{index}]")))?;
        }
        if let Some(key) = error::date_in(&self.provenance) {
            return Err(Fault::key("provenance", Problem::Date { key }));
        }
        if let Some((first, second)) = overlap(&self.drives) {
            let Drive { motor, .. } = self.drives[second];
            let problem = Problem::Overlap { motor, other: first + 1, start_s: self.drives[second].start() };
            return Err(Fault::key(&format!("drive[{second}].motor"), problem));
        }
        Ok(())
    }
}

/// Whether a pattern, or a target, may be called that: 1 to 64 of a-z, 0-9 and -.
pub fn is_name(name: &str) -> bool {
    let letter = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-';
    (1..=64).contains(&name.len()) && name.bytes().all(letter)
}

/// Two drives of one motor of which the second begins before the first has stopped, by their indices. Drives of
/// a motor may follow each other but not overlap.
pub fn overlap(drives: &[Drive]) -> Option<(usize, usize)> {
    let mut order: Vec<usize> = (0..drives.len()).collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (&drives[a], &drives[b]);
        a.motor.cmp(&b.motor).then(a.start().total_cmp(&b.start()))
    });
    let overlapping = |pair: &&[usize]| {
        let (first, second) = (&drives[pair[0]], &drives[pair[1]]);
        first.motor == second.motor && first.stop_s.is_none_or(|stop| stop > second.start())
    };
    order.windows(2).find(overlapping).map(|pair| (pair[0], pair[1]))
}

/// A drive whose frequency leaves too little room for its amplitude: it plays, but smaller.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Warning {
    /// The drive, counted from 1.
    pub drive: usize,
    /// The drive itself.
    pub settings: Drive,
    /// Pulses its amplitude asks for.
    pub wanted_pulses: u32,
    /// Pulses that fit.
    pub reachable_pulses: u32,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Drive { motor, frequency_hz, amplitude_um, .. } = self.settings;
        let (wanted, fit) = (self.wanted_pulses, self.reachable_pulses);
        let um = f64::from(fit) * UM_PER_PULSE;
        write!(
            f,
            "drive {} (motor {motor}) is saturated: {amplitude_um} um at {frequency_hz} Hz wants {wanted} ",
            self.drive
        )?;
        write!(f, "pulses each way, {fit} fit ({um:.1} um); lower frequency_hz or amplitude_um")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(motor: u8, start_s: Option<f64>, stop_s: Option<f64>) -> Drive {
        Drive { motor, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.0, start_s, stop_s }
    }

    fn pattern(drives: Vec<Drive>) -> Result<Pattern, PatternError> {
        Pattern::new("test", Some(2.0), drives, toml::Table::new())
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
        let warnings = pattern(vec![drive(8, None, None), fast]).unwrap().warnings();
        let [warning] = warnings[..] else { panic!("{warnings:?}") };
        assert_eq!((warning.drive, warning.wanted_pulses, warning.reachable_pulses), (2, 589, 141));
        assert!(warning.to_string().contains("(19.1 um)"), "{warning}");
    }
}
