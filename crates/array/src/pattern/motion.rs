//! One motion of a pattern: samples, a ramp and hold, a tone or noise on one motor.
//!
//! Motions of one motor add up where they overlap in time. [`crate::motion`] makes their waveforms and compiles them to moves.

use super::limits::MAX_SOURCE;
use crate::motion::{MotionError, Noise, RampHold, Tone, Waveform};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde::{Serialize, Serializer};
use std::sync::Arc;

/// A motion of one motor: a table of the file.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Motion {
    /// `[[wave]]`: samples.
    Wave(Wave),
    /// `[[ramp]]`: from rest to a level, and back.
    Ramp(RampHold),
    /// `[[tone]]`: a sine or a chirp.
    Tone(Tone),
    /// `[[noise]]`: noise of a band.
    Noise(Noise),
}

/// Samples of displacement, linear between; at rest before and after.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Wave {
    /// One of the array.
    pub motor: u8,
    /// When the first sample is, s.
    pub start_s: f64,
    /// The samples' rate, Hz, within [`RATE_HZ`](crate::motion::RATE_HZ).
    pub rate_hz: f64,
    /// What the samples were made from; at most [`MAX_SOURCE`] bytes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// The displacement above rest, µm. Copies of the pattern share it.
    #[serde(rename = "samples", serialize_with = "packed")]
    pub um: Arc<[f32]>,
}

impl Motion {
    /// The names of the tables, in the order of [`Self::kind`].
    pub(super) const TABLES: [&str; 4] = ["wave", "ramp", "tone", "noise"];

    pub(super) const fn kind(&self) -> usize {
        match self {
            Self::Wave(_) => 0,
            Self::Ramp(_) => 1,
            Self::Tone(_) => 2,
            Self::Noise(_) => 3,
        }
    }

    /// The name of its table in a file.
    pub const fn table(&self) -> &'static str {
        Self::TABLES[self.kind()]
    }

    /// Its motor.
    pub const fn motor(&self) -> u8 {
        match self {
            Self::Wave(wave) => wave.motor,
            Self::Ramp(ramp) => ramp.motor,
            Self::Tone(tone) => tone.motor,
            Self::Noise(noise) => noise.motor,
        }
    }

    /// How many samples or knots its waveform has, told without making it.
    ///
    /// # Errors
    /// A value that is out of range, or too many samples.
    pub fn samples(&self) -> Result<usize, MotionError> {
        match self {
            Self::Wave(wave) => Ok(wave.um.len()),
            Self::Ramp(_) => Ok(RampHold::MOST_KNOTS),
            Self::Tone(tone) => tone.samples(),
            Self::Noise(noise) => noise.samples(),
        }
    }

    /// When it begins, s.
    pub const fn start_s(&self) -> f64 {
        match self {
            Self::Wave(wave) => wave.start_s,
            Self::Ramp(ramp) => ramp.start_s,
            Self::Tone(tone) => tone.start_s,
            Self::Noise(noise) => noise.start_s,
        }
    }

    /// Its waveform.
    ///
    /// # Errors
    /// The first value that is out of range.
    pub fn waveform(&self) -> Result<Waveform, MotionError> {
        match self {
            Self::Wave(wave) => Waveform::shared(wave.start_s, wave.rate_hz, wave.um.clone()),
            Self::Ramp(ramp) => ramp.waveform(),
            Self::Tone(tone) => tone.waveform(),
            Self::Noise(noise) => noise.waveform(),
        }
    }

    /// Whether its source is not longer than [`MAX_SOURCE`].
    pub(super) fn has_short_source(&self) -> bool {
        let Self::Wave(Wave { source: Some(source), .. }) = self else { return true };
        source.len() <= MAX_SOURCE
    }
}

/// Writes samples in base64.
fn packed<S: Serializer>(um: &Arc<[f32]>, to: S) -> Result<S::Ok, S::Error> {
    let bytes: Vec<u8> = um.iter().flat_map(|um| um.to_le_bytes()).collect();
    to.serialize_str(&STANDARD.encode(bytes))
}
