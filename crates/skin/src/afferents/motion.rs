//! The indentation of every pin, sample by sample.
//!
//! Pins move as sines of a formula, or as the motors of an array do. A motor's samples are exact: the mean velocity over a sample
//! comes from the breakpoints in closed form.
//!
//! Invariant: a pin's indentation at a sample does not depend on how many samples are requested at a time.

use super::scene::{Pins, Scene, SinePin};
use super::{SAMPLE_US, SAMPLES_PER_S};
use crate::breakpoints::velocity_per_d;
use crate::method::{Integrator, Method, Stepping};
use crate::sampler::Sampler;
use crate::track::{Track, Tracks, of_drives};
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::ArraySpec;
use std::f64::consts::TAU;
use std::sync::Arc;

/// The mean velocity over a sample.
const STEPS: Stepping = Stepping { step_us: SAMPLE_US, integrator: Integrator::Propagator };
/// Converts the mean D over a sample, half pulses, to the path of a pin, mm.
fn mm_per_mean(array: &ArraySpec) -> f64 {
    velocity_per_d(1e-3, array.motor()) * (array.rate().half_ticks_per_s() / SAMPLES_PER_S)
}

/// The pins of a scene, from its beginning on.
pub(super) struct Motion<'s> {
    preindent_mm: f64,
    moved_by: MovedBy<'s>,
    next: u64,
}

enum MovedBy<'s> {
    Sines { pins: &'s [SinePin], ramp_s: f64, begin_s: f64 },
    Motors { motors: Vec<Motor<'s>>, mm_per_mean: f64 },
}

struct Motor<'s> {
    sampler: Option<Sampler<'s>>,
    gain: f64,
    /// Displacement above its rest, mm, without the gain.
    at_mm: f64,
    samples: Vec<f64>,
}

/// The tracks of a scene whose pins are motors.
pub(super) fn tracks(scene: &Scene) -> Tracks {
    match scene.pins() {
        Pins::Sines { .. } => Vec::new(),
        Pins::Drives(drives) => of_drives(scene.array(), drives, scene.duration_s(), Method::Exact),
        Pins::Ramps(ramps) => ramps.tracks(&ramps.gains(), scene.duration_s()),
    }
}

impl<'s> Motion<'s> {
    pub(super) fn new(scene: &'s Scene, tracks: &'s Tracks) -> Self {
        let motors = |gains: &PerMotor<f64>| {
            let motor = |(track, &gain): (&'s Option<Arc<Track>>, &f64)| {
                let sampler = track.as_ref().map(|track| track.sampled(STEPS));
                Motor { sampler, gain, at_mm: 0.0, samples: Vec::new() }
            };
            let motors = tracks.iter().zip(gains).map(motor).collect();
            MovedBy::Motors { motors, mm_per_mean: mm_per_mean(&scene.array()) }
        };
        let moved_by = match scene.pins() {
            Pins::Sines { pins, ramp_s, begin_s } => {
                MovedBy::Sines { pins, ramp_s: *ramp_s, begin_s: *begin_s }
            }
            Pins::Drives(_) => motors(&PerMotor::all(scene.array(), 1.0)),
            // The full speed is that of the fastest ramp.
            Pins::Ramps(ramps) => motors(&ramps.gains()),
        };
        Self { preindent_mm: scene.preindent_mm(), moved_by, next: 0 }
    }

    /// Appends the indentations of the next samples, mm, to each pin's column.
    pub(super) fn extend(&mut self, samples: usize, columns: &mut [Vec<f64>]) {
        let first = self.next;
        self.next += samples as u64;
        let preindent_mm = self.preindent_mm;
        match &mut self.moved_by {
            MovedBy::Sines { pins, ramp_s, begin_s } => {
                for (pin, column) in pins.iter().zip(columns) {
                    column.extend((first..first + samples as u64).map(|number| {
                        let time_s = number as f64 / SAMPLES_PER_S;
                        let pressed = if time_s < *ramp_s { time_s / *ramp_s } else { 1.0 };
                        preindent_mm * pressed + pin.displacement_mm(time_s - *begin_s)
                    }));
                }
            }
            MovedBy::Motors { motors, mm_per_mean } => {
                for (motor, column) in motors.iter_mut().zip(columns) {
                    let Some(sampler) = &mut motor.sampler else {
                        column.resize(column.len() + samples, preindent_mm);
                        continue;
                    };
                    sampler.fill(first, samples, &mut motor.samples);
                    for mean in &motor.samples[..samples] {
                        column.push(preindent_mm + motor.gain * motor.at_mm);
                        motor.at_mm += mean * *mm_per_mean;
                    }
                }
            }
        }
    }
}

impl SinePin {
    /// Displacement beyond the indentation by the finger, mm, `since_s` after the start of the vibration.
    fn displacement_mm(&self, since_s: f64) -> f64 {
        if since_s < 0.0 || self.amplitude_um == 0.0 {
            return 0.0;
        }
        let phase = |cycles: f64| libm::cos(TAU * cycles);
        self.amplitude_um / 2000.0 * (phase(self.phase) - phase(self.frequency_hz * since_s + self.phase))
    }
}
