//! Reads a pattern file: TOML, with every key known and every error at its line.
//!
//! [`document`](meissner_input::document) reads the keys and their types. Ranges are left to [`Pattern`]'s own check,
//! which serves patterns made in memory too.
//!
//! Invariant: no key is ignored.

use super::Pattern;
use super::drive::Drive;
use super::error::{KeyError, PatternError, Problem};
use super::limits::{FORMAT, MAX_FILE_BYTES, MAX_PACKED_BYTES, MAX_SIZE, MAX_SIZE_OF_MOTIONS};
use super::motion::Motion;
use super::tables::{Files, RawWave, Reader};
use crate::motion::{Noise, RampHold, Tone};
use crate::spec::Array;
use meissner_input::document::{Table, check_size, from_source, from_toml};
use serde::de::IgnoredAny;
use serde::{Deserialize, Deserializer};

impl Pattern {
    /// Reads a pattern file; `file` is its name in errors. A pattern whose waves name files is refused: it is not complete.
    ///
    /// # Errors
    /// The first problem, in one line.
    pub fn parse(text: &str, file: &str) -> Result<Self, PatternError> {
        read(text, Reader::new(None)).map_err(|error| PatternError(error.in_text(text).in_file(Some(file))))
    }

    /// As [`Self::parse`], with the bytes of the files that waves name. [`Self::to_toml`] of the result is complete in itself.
    ///
    /// # Errors
    /// The first problem, in one line.
    pub fn parse_with_files(text: &str, file: &str, files: &mut Files<'_>) -> Result<Self, PatternError> {
        let read = read(text, Reader::new(Some(files)));
        read.map_err(|error| PatternError(error.in_text(text).in_file(Some(file))))
    }
}

impl Pattern {
    /// Reads the keys of a pattern file of this format from another source, such as JSON. A pattern whose waves name files is refused.
    ///
    /// # Errors
    /// The first problem, in one line that begins with `name`.
    pub fn from_keys<'k, S: Deserializer<'k>>(
        format: i64,
        keys: S,
        name: &str,
    ) -> Result<Self, PatternError> {
        let read = || {
            let Table(raw) = from_source::<RawPattern, _, _>(keys, wanted)?;
            check_format(format)?;
            raw.pattern(&mut Reader::new(None))
        };
        read().map_err(|error| PatternError(error.in_file(Some(name))))
    }
}

fn check_format(found: i64) -> Result<(), KeyError> {
    if found == i64::from(FORMAT) { Ok(()) } else { Err(KeyError::key("format", Problem::Format { found })) }
}

fn read(text: &str, mut reader: Reader<'_, '_>) -> Result<Pattern, KeyError> {
    let bytes = text.len();
    if bytes > MAX_PACKED_BYTES {
        return Err(KeyError::whole(None, Problem::TooLargePacked { bytes }));
    }
    // Only decides how much is read.
    let may_have_motions = ["wave", "ramp", "tone", "noise"].iter().any(|table| text.contains(table));
    if bytes > MAX_FILE_BYTES && !may_have_motions {
        return Err(KeyError::whole(None, Problem::TooLarge { bytes }));
    }
    check_size(text, if may_have_motions { MAX_SIZE_OF_MOTIONS } else { MAX_SIZE })?;
    // Read the format first: another format may have other keys.
    let Table(RawFormat { format }) = from_toml(text, wanted)?;
    check_format(format)?;
    let Table(raw) = from_toml::<RawPattern, _>(text, wanted)?;
    let packed: usize = raw.wave.iter().map(|Table(wave)| wave.packed_bytes()).sum();
    if bytes - packed > MAX_FILE_BYTES {
        return Err(KeyError::whole(None, Problem::TooLarge { bytes: bytes - packed }));
    }
    raw.pattern(&mut reader)
}

impl RawPattern {
    fn pattern(self, reader: &mut Reader<'_, '_>) -> Result<Pattern, KeyError> {
        let Self { format: _, name, array, duration_s, drive, wave, ramp, tone, noise, provenance } = self;
        let array = match array {
            None => Array::paper(),
            Some(name) => {
                Array::named(&name).map_err(|unknown| KeyError::key("array", Problem::Array(unknown)))?
            }
        };
        let drives = drive.into_iter().map(|Table(drive)| drive).collect();
        let waves = wave.into_iter().enumerate().map(|(index, Table(raw))| {
            raw.wave(reader).map(Motion::Wave).map_err(|error| error.within(&format!("wave[{index}]")))
        });
        let mut motions = waves.collect::<Result<Vec<_>, _>>()?;
        motions.extend(ramp.into_iter().map(|Table(ramp)| Motion::Ramp(ramp.with_fall())));
        motions.extend(tone.into_iter().map(|Table(tone)| {
            let end_hz = tone.end_hz.filter(|hz| *hz != tone.frequency_hz);
            Motion::Tone(Tone { end_hz, ..tone })
        }));
        motions.extend(noise.into_iter().map(|Table(noise)| Motion::Noise(noise)));
        Pattern {
            format: FORMAT,
            name,
            array,
            duration_s,
            drives,
            motions: motions.into(),
            waveforms: [].into(),
            provenance,
        }
        .checked()
    }
}

fn wanted(key: &str) -> &'static str {
    match key {
        "format" => "format = 1",
        "name" => "name = \"...\", as the file is called",
        "motor" => "the motor's number, from 0 on",
        "frequency_hz" => "a frequency, 0.1 to 300 Hz",
        "duration_s" => "how long it lasts, s",
        "rise_s" => "how long it rises, s; 0 is a jump",
        "to_um" => "a height, um above rest",
        "low_hz" | "high_hz" => "an edge of the band, 0.1 to 300 Hz",
        "seed" => "a whole number; equal seeds give equal noise",
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
    drive: Vec<Table<Drive>>,
    #[serde(default)]
    wave: Vec<Table<RawWave>>,
    #[serde(default)]
    ramp: Vec<Table<RampHold>>,
    #[serde(default)]
    tone: Vec<Table<Tone>>,
    #[serde(default)]
    noise: Vec<Table<Noise>>,
    #[serde(default)]
    provenance: toml::Table,
}
