//! Reads a pattern file: TOML, with every key known and every error at its line.
//!
//! [`document`](meissner_input::document) reads the keys and their types. Ranges are left to [`Pattern`]'s own check,
//! which serves patterns made in memory too.
//!
//! Invariant: no key is ignored.

use super::Pattern;
use super::drive::Drive;
use super::error::{KeyError, PatternError, Problem};
use super::limits::{FORMAT, MAX_FILE_BYTES, MAX_SIZE};
use crate::spec::Array;
use meissner_input::document::{Table, check_size, from_toml, in_range};
use serde::Deserialize;
use serde::de::IgnoredAny;

impl Pattern {
    /// Reads a pattern file; `file` is its name in errors.
    ///
    /// # Errors
    /// The first problem, in one line.
    pub fn parse(text: &str, file: &str) -> Result<Self, PatternError> {
        read(text).map_err(|error| PatternError(error.in_text(text).in_file(Some(file))))
    }
}

fn read(text: &str) -> Result<Pattern, KeyError> {
    if text.len() > MAX_FILE_BYTES {
        return Err(KeyError::whole(None, Problem::TooLarge { bytes: text.len() }));
    }
    check_size(text, MAX_SIZE)?;
    // Read the format first: another format may have other keys.
    let Table(RawFormat { format }) = from_toml(text, wanted)?;
    if format != i64::from(FORMAT) {
        return Err(KeyError::key("format", Problem::Format { found: format }));
    }
    let Table(RawPattern { format: _, name, array, duration_s, drive, provenance }) =
        from_toml(text, wanted)?;
    let array = match array {
        None => Array::paper(),
        Some(name) => {
            Array::named(&name).map_err(|unknown| KeyError::key("array", Problem::Array(unknown)))?
        }
    };
    let drives = drive.into_iter().enumerate();
    let drives = drives.map(|(index, Table(raw))| {
        raw.drive(array).map_err(|error| error.within(&format!("drive[{index}]")))
    });
    let drives = drives.collect::<Result<_, _>>()?;
    let pattern = Pattern { format: FORMAT, name, array, duration_s, drives, provenance };
    pattern.check()?;
    Ok(pattern)
}

fn wanted(key: &str) -> &'static str {
    match key {
        "format" => "format = 1",
        "name" => "name = \"...\", as the file is called",
        "motor" => "the motor's number, from 0 on",
        "frequency_hz" => "a frequency, 0.1 to 300 Hz",
        _ => "an amplitude, um peak to peak",
    }
}

#[derive(Deserialize)]
struct RawFormat {
    format: i64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPattern {
    #[expect(dead_code, reason = "was read before")]
    format: IgnoredAny,
    name: String,
    array: Option<String>,
    duration_s: Option<f64>,
    #[serde(default)]
    drive: Vec<Table<RawDrive>>,
    #[serde(default)]
    provenance: toml::Table,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDrive {
    motor: i64,
    frequency_hz: f64,
    amplitude_um: f64,
    #[serde(default)]
    phase: f64,
    start_s: Option<f64>,
    stop_s: Option<f64>,
}

impl RawDrive {
    #[expect(clippy::cast_precision_loss, reason = "only shown")]
    fn drive(self, array: Array) -> Result<Drive, KeyError> {
        let Self { motor, frequency_hz, amplitude_um, phase, start_s, stop_s } = self;
        let good = (0..array.motors() as i64).contains(&motor);
        in_range("motor", motor as f64, good, array.motor_range())?;
        Ok(Drive { motor: motor as u8, frequency_hz, amplitude_um, phase, start_s, stop_s })
    }
}
