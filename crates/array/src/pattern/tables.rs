//! The tables of motions in a file: reads `[[wave]]`, and writes all.
//!
//! Samples are packed as base64 of 32-bit floating-point numbers, µm, least significant byte first: a file that names another file is
//! read with a function that gives that file's bytes, and is packed when it is written.
//!
//! Invariant: what is written is read back as the same motion.

use super::error::{KeyError, Problem};
use super::limits::MAX_PATTERN_SAMPLES;
use super::motion::{Motion, Wave};
use crate::motion::MAX_SAMPLES;
use crate::samples::{self, Choice, Column, Samples};
use crate::spec::motor_number;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use meissner_input::document::CommonProblem;
use meissner_input::message::{cut, quote};
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serializer};
use std::fmt;
use std::sync::Arc;

/// Gives the bytes of a file by the name that a pattern has for it, at most [`samples::MAX_FILE_BYTES`] and one more, or says
/// why not, in one line.
pub type Files<'a> = dyn FnMut(&str) -> Result<Vec<u8>, String> + 'a;

/// Opens the files of a pattern. The last one is kept: often the waves of all motors are columns of one file.
pub(super) struct Reader<'a, 'f> {
    files: Option<&'a mut Files<'f>>,
    last: Option<(String, Vec<u8>)>,
    /// The samples that were read.
    samples: usize,
}

impl<'a, 'f> Reader<'a, 'f> {
    pub(super) const fn new(files: Option<&'a mut Files<'f>>) -> Self {
        Self { files, last: None, samples: 0 }
    }

    fn read(&mut self, motor: u8, name: &str, choice: &Choice) -> Result<Samples, KeyError> {
        let Some(files) = &mut self.files else {
            return Err(KeyError::key("file", Problem::NotPacked { file: quote(name) }));
        };
        let failed = |message: String| {
            KeyError::key("file", Problem::File { motor, file: quote(name), message: cut(&message, 400) })
        };
        if self.last.as_ref().is_none_or(|(last, _)| last != name) {
            // The old one goes before the new one comes.
            self.last = None;
            self.last = Some((name.to_owned(), files(name).map_err(failed)?));
        }
        let bytes = self.last.as_ref().map_or(&[][..], |(_, bytes)| bytes);
        let samples = samples::read(name, bytes, choice).map_err(|error| failed(error.to_string()))?;
        self.samples += samples.um.len();
        if self.samples > MAX_PATTERN_SAMPLES {
            return Err(KeyError::key("file", Problem::TooManySamples));
        }
        Ok(samples)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawWave {
    #[serde(deserialize_with = "motor_number")]
    motor: u8,
    #[serde(default)]
    start_s: f64,
    rate_hz: Option<f64>,
    um: Option<Vec<f64>>,
    samples: Option<Packed>,
    source: Option<String>,
    file: Option<String>,
    column: Option<Column>,
    channel: Option<u64>,
    scale_um: Option<f64>,
    offset_um: Option<f64>,
}

impl RawWave {
    pub(super) fn wave(self, reader: &mut Reader<'_, '_>) -> Result<Wave, KeyError> {
        let Self { motor, start_s, rate_hz, um, samples, source, file, .. } = &self;
        let (um, rate_hz, source) = match (um, samples, file) {
            (None, None, Some(file)) => {
                let Samples { rate_hz, um, note } = reader.read(*motor, file, &self.choice())?;
                let name = cut(file, 200);
                (um.into(), rate_hz, source.clone().or_else(|| Some(format!("{name}: {note}"))))
            }
            (Some(_), None, None) | (None, Some(_), None) => {
                let of_files = [
                    ("column", self.column.is_some()),
                    ("channel", self.channel.is_some()),
                    ("scale_um", self.scale_um.is_some()),
                    ("offset_um", self.offset_um.is_some()),
                ];
                if let Some((key, _)) = of_files.into_iter().find(|(_, given)| *given) {
                    return Err(KeyError::key(key, Problem::OfFile));
                }
                let missing = || {
                    let wanted = "the rate of the samples, 1 to 8000 Hz";
                    KeyError::common(None, "rate_hz".to_owned(), CommonProblem::Missing { wanted })
                };
                let um = self.packed().unwrap_or_default();
                (um, rate_hz.ok_or_else(missing)?, source.clone())
            }
            _ => return Err(KeyError::whole(None, Problem::OneOfThree)),
        };
        Ok(Wave { motor: *motor, start_s: *start_s, rate_hz, source, um })
    }

    /// The bytes that its packed samples take in a file.
    pub(super) fn packed_bytes(&self) -> usize {
        self.samples.as_ref().map_or(0, |Packed(um)| (4 * um.len()).div_ceil(3) * 4)
    }

    fn packed(&self) -> Option<Arc<[f32]>> {
        let list = || self.um.as_ref().map(|um| um.iter().map(|um| *um as f32).collect());
        self.samples.as_ref().map(|samples| samples.0.clone()).or_else(list)
    }

    fn choice(&self) -> Choice {
        let channel = self.channel.map(|channel| usize::try_from(channel).unwrap_or(usize::MAX));
        let (column, rate_hz, scale_um) = (self.column.clone(), self.rate_hz, self.scale_um);
        Choice { column, channel, rate_hz, scale_um, offset_um: self.offset_um.unwrap_or(0.0) }
    }
}

/// Samples in base64.
struct Packed(Arc<[f32]>);

impl<'de> Deserialize<'de> for Packed {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        struct Text;
        impl Visitor<'_> for Text {
            type Value = Packed;
            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("samples that `meissner pattern pack` has packed")
            }
            fn visit_str<E: Error>(self, text: &str) -> Result<Packed, E> {
                if text.len() / 16 * 3 > MAX_SAMPLES {
                    return Err(E::custom(format_args!(
                        "holds more than {MAX_SAMPLES} samples: make it shorter"
                    )));
                }
                let damaged =
                    || E::custom("is damaged: pack the pattern again, with `meissner pattern pack`");
                let bytes = STANDARD.decode(text).map_err(|_| damaged())?;
                let (samples, rest) = bytes.as_chunks::<4>();
                if !rest.is_empty() {
                    return Err(damaged());
                }
                Ok(Packed(samples.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()))
            }
        }
        source.deserialize_str(Text)
    }
}

/// Writes the motions as four lists of tables; empty ones are left out.
pub(super) fn write<S: Serializer>(motions: &[Motion], to: S) -> Result<S::Ok, S::Error> {
    let lists = Motion::TABLES
        .map(|table| (table, motions.iter().filter(|motion| motion.table() == table).collect::<Vec<_>>()));
    to.collect_map(lists.into_iter().filter(|(_, motions)| !motions.is_empty()))
}
