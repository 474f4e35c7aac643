//! Waveforms by formula: ramp and hold, tones and chirps, band noise.
//!
//! Curves are sampled at 40 times their highest frequency, 1 to 8 kHz, and linear between: the largest error is 0.3 % of the amplitude
//! up to 200 Hz, and 0.7 % at 300 Hz. A cosine ramp has 64 segments: 0.03 % of its height; one shorter than 8 ms has a segment each 0.125 ms,
//! as samples at 8 kHz. So a motion has at most 8 knots a millisecond, and 4 more for its ends.
//!
//! Invariant: equal settings give equal samples, bit for bit, on every machine: all functions are those of `libm`.

use super::error::MotionError;
use super::waveform::{RATE_HZ, Waveform, check_count};
use crate::motor::MAX_AMPLITUDE_UM;
use crate::pattern::{FREQUENCY_HZ, MAX_SECONDS};
use crate::random;
use crate::spec::motor_number;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// The most segments of a cosine ramp.
const SEGMENTS: u32 = 64;
/// Samples per period of the highest frequency.
const PER_PERIOD: f64 = 40.0;
/// The least rate of samples, Hz.
const LEAST_RATE_HZ: f64 = 1000.0;
/// The most samples times lines of noise: a second of work. 5 to 50 Hz for 105 s.
const MOST_WORK: f64 = 1e9;
/// The same of all noise of a pattern.
pub(crate) const MOST_NOISE_WORK: f64 = 4.0 * MOST_WORK;
/// Lines of noise that are added at once: the processor works on them side by side.
const AT_ONCE: usize = 8;
/// Of the keys of random numbers, the part that is the noise's own ("noise").
const NOISE_KEY: u64 = 0x6e_6f69_7365;

/// How a ramp goes from one level to the other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// At constant speed.
    #[default]
    Linear,
    /// As half a cosine, which begins and ends at speed 0; its highest speed is π/2 times that of a linear ramp.
    Cosine,
}

/// From rest to a level, held there, and back to rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RampHold {
    /// Its motor.
    #[serde(deserialize_with = "motor_number")]
    pub motor: u8,
    /// When it begins, s.
    #[serde(default)]
    pub start_s: f64,
    /// The level, µm above rest.
    pub to_um: f64,
    /// Duration of the rise, s; 0 is a jump.
    pub rise_s: f64,
    /// Duration of the hold, s.
    #[serde(default)]
    pub hold_s: f64,
    /// Duration of the fall, s; 0 is a jump. `None`: as the rise.
    pub fall_s: Option<f64>,
    /// Of both ramps.
    #[serde(default)]
    pub shape: Shape,
}

/// The factor by which a tone or noise grows and fades.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(
    untagged,
    deny_unknown_fields,
    expecting = "must be \"hann\", or { attack_s = ..., release_s = ... }"
)]
pub enum Envelope {
    /// By its name.
    Named(Named),
    /// Linear from 0 to 1 over the attack, and to 0 over the release at the end.
    AttackRelease {
        /// Duration of the attack, s.
        #[serde(default)]
        attack_s: f64,
        /// Duration of the release, s.
        #[serde(default)]
        release_s: f64,
    },
}

/// An envelope without settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Named {
    /// (1 - cos 2πt/T)/2.
    Hann,
}

/// A sine, or a linear chirp: envelope · (`about_um` + `amplitude_um`/2 · sin 2π(`phase` + ∫f)).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tone {
    /// Its motor.
    #[serde(deserialize_with = "motor_number")]
    pub motor: u8,
    /// When it begins, s.
    #[serde(default)]
    pub start_s: f64,
    /// How long it lasts, s.
    pub duration_s: f64,
    /// The frequency at its beginning, Hz.
    pub frequency_hz: f64,
    /// The frequency at its end, Hz; between, it changes linearly. `None`: it does not change.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_hz: Option<f64>,
    /// Amplitude, µm peak to peak, as of a drive.
    pub amplitude_um: f64,
    /// The level that it swings about, µm; `None`: half the amplitude, so that the lowest point is at rest. 0 for a tone that is added
    /// to a ramp and hold.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub about_um: Option<f64>,
    /// Phase at its beginning, cycles. At 0.75 the sine begins at its lowest point.
    #[serde(default)]
    pub phase: f64,
    /// Its envelope; `None`: 1 throughout.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub envelope: Option<Envelope>,
}

/// Gaussian noise of a band: envelope · (`about_um` + noise).
///
/// It is a sum of lines at the multiples of 1/`duration_s` from `low_hz` to `high_hz`, both included. Cosine and sine of line k have
/// independent normal amplitudes, [`random::normal`] of `[seed, 0x6e6f697365, k, 0 or 1]`. The spectrum outside the band is 0, and the
/// noise repeats seamlessly after its duration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Noise {
    /// Its motor.
    #[serde(deserialize_with = "motor_number")]
    pub motor: u8,
    /// When it begins, s.
    #[serde(default)]
    pub start_s: f64,
    /// How long it lasts, s.
    pub duration_s: f64,
    /// The band's lower edge, Hz.
    pub low_hz: f64,
    /// The band's upper edge, Hz.
    pub high_hz: f64,
    /// Its root mean square before its envelope, µm; this or `peak_um`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms_um: Option<f64>,
    /// Its largest value of either sign before its envelope, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peak_um: Option<f64>,
    /// The level that it swings about, µm; `None`: its peak, so that no point is below rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub about_um: Option<f64>,
    /// Equal seeds give equal noise.
    pub seed: u64,
    /// Its envelope; `None`: 1 throughout.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub envelope: Option<Envelope>,
}

fn check_um(what: &'static str, um: f64) -> Result<(), MotionError> {
    MotionError::check(what, "um", um, -MAX_AMPLITUDE_UM, MAX_AMPLITUDE_UM)
}

fn check_s(what: &'static str, seconds: f64) -> Result<(), MotionError> {
    MotionError::check(what, "s", seconds, 0.0, MAX_SECONDS)
}

fn check_hz(what: &'static str, hz: f64) -> Result<(), MotionError> {
    MotionError::check(what, "Hz", hz, *FREQUENCY_HZ.start(), *FREQUENCY_HZ.end())
}

impl RampHold {
    /// The segments of a ramp of so many seconds.
    fn segments(&self, seconds: f64) -> u32 {
        let shortest = (seconds * RATE_HZ.end()).ceil() as u32;
        if self.shape == Shape::Linear { 1 } else { shortest.clamp(1, SEGMENTS) }
    }

    /// The most knots that its waveform has.
    pub(crate) const MOST_KNOTS: usize = 2 * (SEGMENTS as usize + 1);

    /// The same with the duration of its fall, as patterns are written.
    pub(crate) fn with_fall(self) -> Self {
        Self { fall_s: self.fall_s.or(Some(self.rise_s)), ..self }
    }

    /// Its waveform.
    ///
    /// # Errors
    /// The first value that is out of range.
    pub fn waveform(&self) -> Result<Waveform, MotionError> {
        check_um("to_um", self.to_um)?;
        let fall_s = self.fall_s.unwrap_or(self.rise_s);
        for (what, seconds) in [("rise_s", self.rise_s), ("hold_s", self.hold_s), ("fall_s", fall_s)] {
            check_s(what, seconds)?;
        }
        let risen = |number: u32, segments: u32| {
            let share = f64::from(number) / f64::from(segments);
            (share, if self.shape == Shape::Linear { share } else { 0.5 - 0.5 * libm::cos(PI * share) })
        };
        let [rise, fall] = [self.rise_s, fall_s].map(|seconds| self.segments(seconds));
        let rise = (0..=rise).map(|number| {
            let (time, height) = risen(number, rise);
            (self.rise_s * time, self.to_um * height)
        });
        let held_s = self.rise_s + self.hold_s;
        let fall = (0..=fall).map(|number| {
            let (time, left) = risen(fall - number, fall);
            (held_s + fall_s * (1.0 - time), self.to_um * left)
        });
        let points: Vec<_> = rise.chain(fall).collect();
        Waveform::of(self.start_s, points.into_iter())
    }
}

impl Envelope {
    /// (1 - cos 2πt/T)/2.
    pub const HANN: Self = Self::Named(Named::Hann);

    fn check(self) -> Result<(), MotionError> {
        let Self::AttackRelease { attack_s, release_s } = self else { return Ok(()) };
        check_s("attack_s", attack_s)?;
        check_s("release_s", release_s)
    }

    /// The factor `after_s` into `duration_s`.
    fn at(self, after_s: f64, duration_s: f64) -> f64 {
        match self {
            Self::Named(Named::Hann) => 0.5 - 0.5 * libm::cos(TAU * after_s / duration_s),
            Self::AttackRelease { attack_s, release_s } => {
                let edge =
                    |passed_s: f64, edge_s: f64| if passed_s >= edge_s { 1.0 } else { passed_s / edge_s };
                edge(after_s, attack_s) * edge(duration_s - after_s, release_s)
            }
        }
    }
}

/// The number of intervals of samples that end exactly at the duration.
fn intervals(duration_s: f64, highest_hz: f64) -> Result<u32, MotionError> {
    MotionError::check("duration_s", "s", duration_s, 1.0 / LEAST_RATE_HZ, MAX_SECONDS)?;
    let rate_hz = (PER_PERIOD * highest_hz).clamp(LEAST_RATE_HZ, *RATE_HZ.end());
    let intervals = (duration_s * rate_hz).ceil() as u32;
    check_count(samples(intervals))?;
    Ok(intervals)
}

/// The number of samples at the ends of so many intervals.
fn samples(intervals: u32) -> usize {
    usize::try_from(intervals).unwrap_or(usize::MAX).saturating_add(1)
}

/// The waveform of an envelope and what it shapes, which is asked for each sample: its number, s.
fn shaped(
    start_s: f64,
    duration_s: f64,
    intervals: u32,
    envelope: Option<Envelope>,
    of: impl Fn(u32, f64) -> f64,
) -> Result<Waveform, MotionError> {
    envelope.map_or(Ok(()), Envelope::check)?;
    let step_s = duration_s / f64::from(intervals);
    let um = (0..intervals + 1).map(|number| {
        let after_s = f64::from(number) * step_s;
        let factor = envelope.map_or(1.0, |envelope| envelope.at(after_s, duration_s));
        (factor * of(number, after_s)) as f32
    });
    Waveform::at_rate(start_s, f64::from(intervals) / duration_s, um.collect())
}

impl Tone {
    fn intervals(&self) -> Result<u32, MotionError> {
        check_hz("frequency_hz", self.frequency_hz)?;
        check_hz("end_hz", self.end())?;
        intervals(self.duration_s, self.frequency_hz.max(self.end()))
    }

    fn end(&self) -> f64 {
        self.end_hz.unwrap_or(self.frequency_hz)
    }

    /// How many samples its waveform has.
    ///
    /// # Errors
    /// A frequency or a duration that is out of range, or more samples than a waveform has.
    pub fn samples(&self) -> Result<usize, MotionError> {
        self.intervals().map(samples)
    }

    /// Its waveform.
    ///
    /// # Errors
    /// The first value that is out of range, or more samples than a waveform has.
    pub fn waveform(&self) -> Result<Waveform, MotionError> {
        let intervals = self.intervals()?;
        check_um("amplitude_um", self.amplitude_um)?;
        let half_um = self.amplitude_um / 2.0;
        let about_um = self.about_um.unwrap_or(half_um);
        check_um("about_um", about_um)?;
        MotionError::check("phase", "cycles", self.phase, 0.0, 1.0)?;
        let chirp = (self.end() - self.frequency_hz) / (2.0 * self.duration_s);
        shaped(self.start_s, self.duration_s, intervals, self.envelope, |_, after_s| {
            let cycles = self.phase + (self.frequency_hz + chirp * after_s) * after_s;
            // Whole cycles are dropped before the sine, so that it is exact after hours.
            about_um + half_um * libm::sin(TAU * (cycles - cycles.floor()))
        })
    }
}

impl Noise {
    fn intervals(&self) -> Result<u32, MotionError> {
        check_hz("low_hz", self.low_hz)?;
        check_hz("high_hz", self.high_hz)?;
        intervals(self.duration_s, self.high_hz)
    }

    /// How many samples its waveform has.
    ///
    /// # Errors
    /// A frequency or a duration that is out of range, or more samples than a waveform has.
    pub fn samples(&self) -> Result<usize, MotionError> {
        self.intervals().map(samples)
    }

    /// Its waveform.
    ///
    /// # Errors
    /// The first value that is out of range, a band without lines, or noise that takes too long to make.
    pub fn waveform(&self) -> Result<Waveform, MotionError> {
        let intervals = self.intervals()?;
        check_um("rms_um", self.rms_um.unwrap_or(0.0))?;
        check_um("peak_um", self.peak_um.unwrap_or(0.0))?;
        let raw = self.lines(intervals)?;
        let peak = raw.iter().fold(0.0, |peak: f64, um| peak.max(um.abs()));
        let by_rms = |um: f64| {
            // The last sample repeats the first.
            let squares: f64 = raw[1..].iter().map(|um| um * um).sum();
            um / (squares / f64::from(intervals)).sqrt()
        };
        // One of both is given.
        let scale = self.peak_um.map_or_else(|| by_rms(self.rms_um.unwrap_or(0.0)), |um| um / peak);
        let about_um = self.about_um.unwrap_or((scale * peak).abs());
        check_um("about_um", about_um)?;
        shaped(self.start_s, self.duration_s, intervals, self.envelope, |number, _| {
            about_um + scale * raw[number as usize]
        })
    }

    /// The number of samples times lines: what it takes to make them.
    pub(crate) fn work(&self) -> Result<f64, MotionError> {
        let (first, last) = self.band()?;
        let work = (last - first + 1) as f64 * f64::from(self.intervals()?);
        if work > MOST_WORK { Err(MotionError::TooLong { seconds: self.duration_s }) } else { Ok(work) }
    }

    /// The first and the last line, as multiples of 1/`duration_s`.
    fn band(&self) -> Result<(u64, u64), MotionError> {
        let seconds = self.duration_s;
        // Edges that are lines count, whatever the rounding.
        let first = ((self.low_hz * seconds - 1e-6).ceil() as u64).max(1);
        let last = (self.high_hz * seconds + 1e-6).floor() as u64;
        if first > last {
            return Err(MotionError::Band { seconds, low_hz: self.low_hz, high_hz: self.high_hz });
        }
        Ok((first, last))
    }

    /// The sum of the lines, not scaled, at each end of so many intervals.
    fn lines(&self, intervals: u32) -> Result<Vec<f64>, MotionError> {
        self.work()?;
        let (first, last) = self.band()?;
        let mut sum = vec![0.0; intervals as usize + 1];
        for begin in (first..=last).step_by(AT_ONCE) {
            // Points that turn by their angles from sample to sample. Those after the last line stay at 0.
            let (mut x, mut y, mut cos, mut sin) =
                ([0.0; AT_ONCE], [0.0; AT_ONCE], [1.0; AT_ONCE], [0.0; AT_ONCE]);
            for (place, line) in (begin..=last).take(AT_ONCE).enumerate() {
                [x[place], y[place]] = [0, 1].map(|part| random::normal([self.seed, NOISE_KEY, line, part]));
                let angle = TAU * line as f64 / f64::from(intervals);
                (cos[place], sin[place]) = (libm::cos(angle), libm::sin(angle));
            }
            for um in &mut sum {
                for place in 0..AT_ONCE {
                    *um += x[place];
                    (x[place], y[place]) = (
                        x[place] * cos[place] + y[place] * sin[place],
                        y[place] * cos[place] - x[place] * sin[place],
                    );
                }
            }
        }
        Ok(sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::tests::{noise, ramp, tone};

    fn at(wave: &Waveform, seconds: f64) -> f64 {
        wave.um_at((seconds * 1e9).round() as u64)
    }

    #[test]
    fn a_ramp_rises_holds_and_falls() {
        let ramp = RampHold { fall_s: Some(0.1), ..ramp(200.0, 0.05) };
        let linear = ramp.waveform().unwrap();
        assert_eq!(linear.knots().count(), 4);
        assert_eq!(
            [0.1, 0.125, 0.15, 0.35, 0.4, 0.45].map(|s| at(&linear, s)),
            [0.0, 100.0, 200.0, 200.0, 100.0, 0.0]
        );
        let cosine = RampHold { shape: Shape::Cosine, ..ramp }.waveform().unwrap();
        assert!((at(&cosine, 0.1125) - 200.0 * (0.5 - 0.125_f64.sqrt())).abs() < 0.06);
        assert!((at(&cosine, 0.4) - 100.0).abs() < 1e-6);
        let jump = RampHold { rise_s: 0.0, hold_s: 0.1, fall_s: Some(0.0), ..ramp }.waveform().unwrap();
        assert_eq!([100_000_000, 200_000_000].map(|ns| jump.um_around(ns)), [[0.0, 200.0], [200.0, 0.0]]);
    }

    #[test]
    fn a_tone_has_its_frequency_amplitude_phase_and_envelope() {
        let steady = tone(50.0, 50.0, 10.0, None).waveform().unwrap();
        assert_eq!((at(&steady, 0.0), at(&steady, 0.005), at(&steady, 0.5)), (5.0, 10.0, 5.0));
        // A chirp's phase: 10 t + 40 t²/2 cycles, after half a second 10 of them.
        let chirp = tone(10.0, 50.0, 10.0, None).waveform().unwrap();
        assert!((at(&chirp, 0.5) - 5.0).abs() < 1e-9 && at(&chirp, 0.5 + 0.25 / 30.0) > 9.98);
        let low = Tone { phase: 0.75, ..tone(50.0, 50.0, 10.0, None) }.waveform().unwrap();
        assert!(at(&low, 0.0).abs() < 1e-9);
        let edges = Some(Envelope::AttackRelease { attack_s: 0.1, release_s: 0.2 });
        let still = Tone { about_um: Some(8.0), ..tone(50.0, 50.0, 0.0, edges) }.waveform().unwrap();
        assert_eq!([0.05, 0.5, 0.9].map(|s| (at(&still, s) * 1e6).round() / 1e6), [4.0, 8.0, 4.0]);
        let hann =
            Tone { envelope: Some(Envelope::HANN), ..tone(50.0, 50.0, 10.0, edges) }.waveform().unwrap();
        // At a crest, 10 times (1 - cos 95.4°)/2.
        assert!((at(&hann, 0.265) - 5.4705).abs() < 0.02 && at(&hann, 1.0).abs() < 1e-9);
        assert!(
            tone(0.0, 5.0, 1.0, edges).waveform().is_err()
                && tone(5.0, 301.0, 1.0, edges).waveform().is_err()
        );
    }

    #[test]
    fn noise_has_its_band_and_strength_and_never_changes() {
        let wave = noise(5.0, 50.0, 10.0, 7).waveform().unwrap();
        let um: Vec<f64> = (0..4000_u64).map(|k| wave.um_at(k * 500_000)).collect();
        let mean = um.iter().sum::<f64>() / 4000.0;
        let rms = (um.iter().map(|um| (um - mean).powi(2)).sum::<f64>() / 4000.0).sqrt();
        assert!(
            (rms - 10.0).abs() < 1e-6 && (wave.extremes_um()[0], mean > 20.0) == (0.0, true),
            "{rms} {mean}"
        );
        // By projection: nothing outside the band; inside, some from each tenth of it.
        let line = |k: u32| {
            let part = |turn: f64| -> f64 {
                (0..).zip(&um).map(|(n, um)| um * (TAU * (f64::from(k * n) / 4000.0 + turn)).cos()).sum()
            };
            (part(0.0).powi(2) + part(0.25).powi(2)) / 4e6
        };
        assert!((1..10).chain(101..140).all(|k| line(k) < 1e-12));
        let power: f64 = (10..=100).map(line).sum();
        assert!((power / 2.0 * 2.0 - 200.0).abs() < 1e-6, "{power}");
        let golden: Vec<u64> = [3, 1000, 3999].map(|k: usize| um[k].to_bits()).to_vec();
        assert_eq!(golden, GOLDEN, "{golden:#x?}");
        let peak =
            Noise { rms_um: None, peak_um: Some(20.0), ..noise(5.0, 50.0, 10.0, 7) }.waveform().unwrap();
        assert!((at(&peak, 0.3) / at(&wave, 0.3) - 20.0 / mean).abs() < 1e-6);
        assert_ne!(noise(5.0, 50.0, 10.0, 8).waveform().unwrap(), wave);
    }

    const GOLDEN: [u64; 3] = [0x403b_6531_e000_0000, 0x4046_432b_2000_0000, 0x403e_ba0d_a000_0000];

    #[test]
    fn noise_without_lines_or_too_long_is_refused() {
        let refused = |noise: Noise| noise.waveform().unwrap_err().to_string();
        assert_eq!(
            refused(noise(5.1, 5.2, 1.0, 0)),
            "noise of 2 s has no frequency from 5.1 to 5.2 Hz: make the band at least 0.5 Hz wide"
        );
        let long = Noise { duration_s: 1000.0, ..noise(5.0, 50.0, 1.0, 0) };
        assert!(refused(long).starts_with("noise of 1000 s takes too long"));
    }
}
