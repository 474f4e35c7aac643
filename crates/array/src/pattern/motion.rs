//! One motion of a pattern: samples, a ramp and hold, a tone or noise on one motor.
//!
//! Motions of one motor add up where they overlap in time. [`crate::motion`] makes their waveforms and compiles them to moves.

use super::limits::MAX_SOURCE;
use crate::motion::{MotionError, Noise, RampHold, Strength, Tone, Waveform};
use std::sync::Arc;

/// A motion of one motor.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// One of the array.
    pub motor: u8,
    /// What the motor does.
    pub form: Form,
}

/// What a motor does in a motion: a table of the file.
#[derive(Clone, Debug, PartialEq)]
pub enum Form {
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
#[derive(Clone, Debug, PartialEq)]
pub struct Wave {
    /// When the first sample is, s.
    pub start_s: f64,
    /// The samples' rate, Hz, within [`RATE_HZ`](crate::motion::RATE_HZ).
    pub rate_hz: f64,
    /// The displacement above rest, µm. Copies of the pattern share it.
    pub um: Arc<[f32]>,
    /// What the samples were made from; at most [`MAX_SOURCE`] bytes.
    pub source: Option<String>,
}

impl Form {
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
    #[must_use]
    pub const fn table(&self) -> &'static str {
        Self::TABLES[self.kind()]
    }

    /// How many samples or knots its waveform has, told without making it.
    ///
    /// # Errors
    /// A value that is out of range, or too many samples.
    pub fn samples(&self) -> Result<usize, MotionError> {
        match self {
            Self::Wave(wave) => Ok(wave.um.len()),
            Self::Ramp(ramp) => Ok(ramp.most_knots()),
            Self::Tone(tone) => tone.samples(),
            Self::Noise(noise) => noise.samples(),
        }
    }

    /// When it begins and ends, s.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "a number of samples")]
    pub fn span_s(&self) -> (f64, f64) {
        let (start_s, lasts_s) = match self {
            Self::Wave(wave) => (wave.start_s, wave.um.len().saturating_sub(1) as f64 / wave.rate_hz),
            Self::Ramp(ramp) => (ramp.start_s, ramp.rise_s + ramp.hold_s + ramp.fall_s),
            Self::Tone(tone) => (tone.start_s, tone.duration_s),
            Self::Noise(noise) => (noise.start_s, noise.duration_s),
        };
        (start_s, start_s + lasts_s)
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

    /// The same motion, so many times as high.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "samples are f32")]
    pub fn scaled(&self, factor: f64) -> Self {
        match self.clone() {
            Self::Wave(wave) => {
                let um = wave.um.iter().map(|um| (f64::from(*um) * factor) as f32).collect();
                Self::Wave(Wave { um, ..wave })
            }
            Self::Ramp(ramp) => Self::Ramp(RampHold { to_um: ramp.to_um * factor, ..ramp }),
            Self::Tone(tone) => {
                let about_um = tone.about_um.map(|um| um * factor);
                Self::Tone(Tone { amplitude_um: tone.amplitude_um * factor, about_um, ..tone })
            }
            Self::Noise(noise) => {
                let strength = match noise.strength {
                    Strength::RmsUm(um) => Strength::RmsUm(um * factor),
                    Strength::PeakUm(um) => Strength::PeakUm(um * factor),
                };
                Self::Noise(Noise { strength, about_um: noise.about_um.map(|um| um * factor), ..noise })
            }
        }
    }

    /// Whether its source is not longer than [`MAX_SOURCE`].
    pub(super) fn has_short_source(&self) -> bool {
        let Self::Wave(Wave { source: Some(source), .. }) = self else { return true };
        source.len() <= MAX_SOURCE
    }
}
