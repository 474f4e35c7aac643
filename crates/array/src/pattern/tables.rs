//! The tables of motions in a file: reads and writes `[[wave]]`, `[[ramp]]`, `[[tone]]` and `[[noise]]`.
//!
//! Samples are packed as base64 of 32-bit floating-point numbers, µm, least significant byte first: a file that names another file is
//! read with a function that gives that file's bytes, and is packed when it is written.
//!
//! Invariant: what is written is read back as the same motion.

use super::error::{KeyError, Problem};
use super::limits::MAX_PATTERN_SAMPLES;
use super::motion::{Form, Motion, Wave};
use crate::motion::{Envelope, MAX_SAMPLES, Noise, RampHold, Shape, Strength, Tone};
use crate::samples::{self, Choice, Column, Samples};
use crate::spec::Array;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use meissner_input::document::{CommonProblem, Table, in_range};
use meissner_input::message::{cut, quote};
use serde::de::{Error, Visitor};
use serde::ser::SerializeStruct;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::sync::Arc;

/// Gives the bytes of a file by the name that a pattern has for it, at most [`samples::MAX_FILE_BYTES`] and one more, or says
/// why not, in one line.
pub type Files<'a> = dyn FnMut(&str) -> Result<Vec<u8>, String> + 'a;

/// Reads the motor's number.
#[expect(clippy::cast_precision_loss, reason = "only shown")]
pub(super) fn motor_of(array: Array, motor: i64) -> Result<u8, KeyError> {
    let good = (0..array.motors() as i64).contains(&motor);
    in_range("motor", motor as f64, good, array.motor_range())?;
    Ok(motor as u8)
}

/// A whole number that is not negative.
#[expect(clippy::cast_precision_loss, reason = "only shown")]
fn natural(key: &str, number: i64) -> Result<u64, KeyError> {
    u64::try_from(number).or_else(|_| in_range(key, number as f64, false, "0 or more").map(|()| 0))
}

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
    motor: i64,
    #[serde(default)]
    start_s: f64,
    rate_hz: Option<f64>,
    um: Option<Vec<f64>>,
    samples: Option<Packed>,
    source: Option<String>,
    file: Option<String>,
    column: Option<Column>,
    channel: Option<i64>,
    scale_um: Option<f64>,
    offset_um: Option<f64>,
}

impl RawWave {
    pub(super) fn motion(self, array: Array, reader: &mut Reader<'_, '_>) -> Result<Motion, KeyError> {
        let Self { motor, start_s, rate_hz, um, samples, source, file, .. } = &self;
        let motor = motor_of(array, *motor)?;
        let (um, rate_hz, source) = match (um, samples, file) {
            (None, None, Some(file)) => {
                let Samples { rate_hz, um, note } = reader.read(motor, file, &self.choice()?)?;
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
        Ok(Motion { motor, form: Form::Wave(Wave { start_s: *start_s, rate_hz, um, source }) })
    }

    /// The bytes that its packed samples take in a file.
    pub(super) fn packed_bytes(&self) -> usize {
        self.samples.as_ref().map_or(0, |Packed(um)| (4 * um.len()).div_ceil(3) * 4)
    }

    #[expect(clippy::cast_possible_truncation, reason = "samples are f32; what is beyond is refused later")]
    fn packed(&self) -> Option<Arc<[f32]>> {
        let list = || self.um.as_ref().map(|um| um.iter().map(|um| *um as f32).collect());
        self.samples.as_ref().map(|samples| samples.0.clone()).or_else(list)
    }

    fn choice(&self) -> Result<Choice, KeyError> {
        let channel = self.channel.map(|channel| natural("channel", channel)).transpose()?;
        let channel = channel.map(|channel| usize::try_from(channel).unwrap_or(usize::MAX));
        let (column, rate_hz, scale_um) = (self.column.clone(), self.rate_hz, self.scale_um);
        Ok(Choice { column, channel, rate_hz, scale_um, offset_um: self.offset_um.unwrap_or(0.0) })
    }
}

/// Samples in base64.
struct Packed(Arc<[f32]>);

impl Serialize for Packed {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let bytes: Vec<u8> = self.0.iter().flat_map(|um| um.to_le_bytes()).collect();
        to.serialize_str(&STANDARD.encode(bytes))
    }
}

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

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawRamp {
    motor: i64,
    #[serde(default)]
    start_s: f64,
    to_um: f64,
    rise_s: f64,
    #[serde(default)]
    hold_s: f64,
    fall_s: Option<f64>,
    #[serde(default)]
    shape: Shape,
}

impl RawRamp {
    pub(super) fn motion(self, array: Array) -> Result<Motion, KeyError> {
        let Self { motor, start_s, to_um, rise_s, hold_s, fall_s, shape } = self;
        let (motor, fall_s) = (motor_of(array, motor)?, fall_s.unwrap_or(rise_s));
        Ok(Motion { motor, form: Form::Ramp(RampHold { start_s, to_um, rise_s, hold_s, fall_s, shape }) })
    }

    fn of(motor: u8, ramp: &RampHold) -> Self {
        let RampHold { start_s, to_um, rise_s, hold_s, fall_s, shape } = *ramp;
        Self { motor: motor.into(), start_s, to_um, rise_s, hold_s, fall_s: Some(fall_s), shape }
    }
}

#[derive(Serialize, Deserialize)]
#[serde(untagged, expecting = "must be \"hann\", or { attack_s = ..., release_s = ... }")]
enum RawEnvelope {
    Name(RawHann),
    Edges(RawEdges),
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum RawHann {
    Hann,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawEdges {
    #[serde(default)]
    attack_s: f64,
    #[serde(default)]
    release_s: f64,
}

impl RawEnvelope {
    fn envelope(raw: Option<Self>) -> Envelope {
        match raw {
            None => Envelope::None,
            Some(Self::Name(RawHann::Hann)) => Envelope::Hann,
            Some(Self::Edges(RawEdges { attack_s, release_s })) => {
                Envelope::AttackRelease { attack_s, release_s }
            }
        }
    }

    const fn of(envelope: Envelope) -> Option<Self> {
        match envelope {
            Envelope::None => None,
            Envelope::Hann => Some(Self::Name(RawHann::Hann)),
            Envelope::AttackRelease { attack_s, release_s } => {
                Some(Self::Edges(RawEdges { attack_s, release_s }))
            }
        }
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawTone {
    motor: i64,
    #[serde(default)]
    start_s: f64,
    duration_s: f64,
    frequency_hz: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    end_hz: Option<f64>,
    amplitude_um: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    about_um: Option<f64>,
    #[serde(default)]
    phase: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    envelope: Option<RawEnvelope>,
}

impl RawTone {
    pub(super) fn motion(self, array: Array) -> Result<Motion, KeyError> {
        let Self {
            motor,
            start_s,
            duration_s,
            frequency_hz,
            end_hz,
            amplitude_um,
            about_um,
            phase,
            envelope,
        } = self;
        let motor = motor_of(array, motor)?;
        let (start_hz, end_hz) = (frequency_hz, end_hz.unwrap_or(frequency_hz));
        let envelope = RawEnvelope::envelope(envelope);
        let tone = Tone { start_s, duration_s, start_hz, end_hz, amplitude_um, about_um, phase, envelope };
        Ok(Motion { motor, form: Form::Tone(tone) })
    }

    fn of(motor: u8, tone: &Tone) -> Self {
        let Tone { start_s, duration_s, start_hz, end_hz, amplitude_um, about_um, phase, envelope } = *tone;
        Self {
            motor: motor.into(),
            start_s,
            duration_s,
            frequency_hz: start_hz,
            end_hz: (end_hz != start_hz).then_some(end_hz),
            amplitude_um,
            about_um,
            phase,
            envelope: RawEnvelope::of(envelope),
        }
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawNoise {
    motor: i64,
    #[serde(default)]
    start_s: f64,
    duration_s: f64,
    low_hz: f64,
    high_hz: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    rms_um: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    peak_um: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    about_um: Option<f64>,
    seed: i64,
    #[serde(skip_serializing_if = "Option::is_none")]
    envelope: Option<RawEnvelope>,
}

impl RawNoise {
    pub(super) fn motion(self, array: Array) -> Result<Motion, KeyError> {
        let Self { motor, start_s, duration_s, low_hz, high_hz, rms_um, peak_um, about_um, seed, envelope } =
            self;
        let motor = motor_of(array, motor)?;
        let strength = match (rms_um, peak_um) {
            (Some(um), None) => Strength::RmsUm(um),
            (None, Some(um)) => Strength::PeakUm(um),
            _ => return Err(KeyError::whole(None, Problem::Strength)),
        };
        let (seed, envelope) = (natural("seed", seed)?, RawEnvelope::envelope(envelope));
        let noise = Noise { start_s, duration_s, low_hz, high_hz, strength, about_um, seed, envelope };
        Ok(Motion { motor, form: Form::Noise(noise) })
    }

    fn of(motor: u8, noise: &Noise) -> Self {
        let Noise { start_s, duration_s, low_hz, high_hz, strength, about_um, seed, envelope } = *noise;
        let (rms_um, peak_um) = match strength {
            Strength::RmsUm(um) => (Some(um), None),
            Strength::PeakUm(um) => (None, Some(um)),
        };
        let (motor, seed) = (motor.into(), i64::try_from(seed).unwrap_or(i64::MAX));
        let envelope = RawEnvelope::of(envelope);
        Self { motor, start_s, duration_s, low_hz, high_hz, rms_um, peak_um, about_um, seed, envelope }
    }
}

/// A wave as it is written: packed.
#[derive(Serialize)]
struct PackedWave<'a> {
    motor: u8,
    start_s: f64,
    rate_hz: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    source: Option<&'a str>,
    samples: Packed,
}

/// Writes the motions as four lists of tables; empty ones are left out.
pub(super) fn write<S: Serializer>(motions: &[Motion], to: S) -> Result<S::Ok, S::Error> {
    let (mut waves, mut ramps, mut tones, mut noises) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for Motion { motor, form } in motions {
        match form {
            Form::Wave(Wave { start_s, rate_hz, um, source }) => waves.push(PackedWave {
                motor: *motor,
                start_s: *start_s,
                rate_hz: *rate_hz,
                source: source.as_deref(),
                samples: Packed(um.clone()),
            }),
            Form::Ramp(ramp) => ramps.push(RawRamp::of(*motor, ramp)),
            Form::Tone(tone) => tones.push(RawTone::of(*motor, tone)),
            Form::Noise(noise) => noises.push(RawNoise::of(*motor, noise)),
        }
    }
    let mut lists = to.serialize_struct("motions", 4)?;
    if !waves.is_empty() {
        lists.serialize_field("wave", &waves)?;
    }
    if !ramps.is_empty() {
        lists.serialize_field("ramp", &ramps)?;
    }
    if !tones.is_empty() {
        lists.serialize_field("tone", &tones)?;
    }
    if !noises.is_empty() {
        lists.serialize_field("noise", &noises)?;
    }
    lists.end()
}

/// The tables of a file as motions, each with the error's place.
pub(super) fn motions<T>(
    name: &str,
    tables: Vec<Table<T>>,
    mut of: impl FnMut(T) -> Result<Motion, KeyError>,
) -> impl Iterator<Item = Result<Motion, KeyError>> {
    let place = move |index| format!("{name}[{index}]");
    tables
        .into_iter()
        .enumerate()
        .map(move |(index, Table(raw))| of(raw).map_err(|error| error.within(&place(index))))
}
