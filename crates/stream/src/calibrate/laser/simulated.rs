//! What a laser would record of a simulated motor that plays a plan: to try the procedure, and the fit, without a laser.
//!
//! A simulated motor's scatter depends on its seed and the tick of each burst alone, so the recording is of exactly the bursts
//! that the simulated array played.
//!
//! Invariant: the same plan, motors and sensor give the same recording.

use crate::calibrate::laser::played::{PlayedBurst, PlayedPlan};
use firmware_protocol::tick::Tick;
use meissner_array::random::{normal, uniform};
use meissner_array::simulated::{Pin, SimulatedMotorsConfig};
use std::fmt::Write;

/// A displacement sensor and its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Samples per second.
    pub samples_per_s: f64,
    /// Noise of a sample, one standard deviation, µm.
    pub noise_um: f64,
    /// Drift, µm/s.
    pub drift_um_per_s: f64,
    /// What it shows of a pin at rest, µm.
    pub offset_um: f64,
    /// By how much its clock runs faster than the device's, ppm.
    pub clock_error_ppm: f64,
    /// How long it records before the first and after the last burst, s; negative: it begins later, or ends earlier.
    pub before_s: f64,
    /// See `before_s`.
    pub after_s: f64,
    /// The time of its first sample, s.
    pub first_s: f64,
    /// Share of samples that are missing.
    pub missing: f64,
    /// Whether it counts downwards.
    pub reversed: bool,
    /// The seed of its noise.
    pub seed: u64,
}

impl Default for Sensor {
    /// A sensor with the errors of a real one.
    fn default() -> Self {
        Self {
            samples_per_s: 1000.0,
            noise_um: 0.1,
            drift_um_per_s: 0.05,
            offset_um: 37.2,
            clock_error_ppm: 500.0,
            before_s: 3.0,
            after_s: 2.0,
            first_s: 12.5,
            missing: 0.005,
            reversed: false,
            seed: 0,
        }
    }
}

/// The CSV text that the sensor would record of the plan's motor in the simulated array.
#[must_use]
pub fn simulated_recording(played: &PlayedPlan, motors: &SimulatedMotorsConfig, sensor: &Sensor) -> String {
    let mut pin = Pin::new(played.array(), motors, played.motor().into());
    let rate = played.array().rate();
    // The tick of the first burst, and how far back the recording begins.
    let onset = played.bursts().first().map_or(0, |first| first.tick);
    let mut bursts = played.bursts().iter().map(PlayedBurst::burst).peekable();
    let seconds = sensor.before_s + played.duration_s() + sensor.after_s;
    let count = (seconds * sensor.samples_per_s) as u64;
    let mut text = String::from("time_s,displacement_um\n");
    for n in 0..count {
        let elapsed_s = n as f64 / sensor.samples_per_s;
        // The sensor counts time with its own clock.
        let since_s = elapsed_s / (1.0 + sensor.clock_error_ppm / 1e6) - sensor.before_s;
        let tick = Tick(match since_s < 0.0 {
            true => onset.saturating_sub(rate.seconds_to_ticks(-since_s)),
            false => onset + rate.seconds_to_ticks(since_s),
        });
        while let Some(burst) = bursts.next_if(|burst| burst.start <= tick) {
            pin.play(burst);
        }
        let um = pin.displacement_um(tick) + sensor.drift_um_per_s * elapsed_s;
        let shown = sensor.offset_um + if sensor.reversed { -um } else { um };
        if uniform([sensor.seed, n, 0, 1])[0] < sensor.missing {
            continue;
        }
        let shown = shown + sensor.noise_um * normal([sensor.seed, n, 0, 0]);
        // Writing to a string does not fail.
        let _ = writeln!(text, "{:.6},{shown:.4}", sensor.first_s + elapsed_s);
    }
    text
}
