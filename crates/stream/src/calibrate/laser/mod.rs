//! Calibration with a laser: gains of one motor from a recording of its pin, on a device without telemetry.
//!
//! 1. `played`: a [`PlayedPlan`] lists the bursts of a plan that was played, each with its tick.
//! 2. `recording`: a [`Recording`] is what a displacement sensor saw of the pin: a table of time and displacement. `columns` says
//!    what its columns are.
//! 3. `align`: the bursts in the recording tell when the plan began by the sensor's clock, and how fast that clock runs.
//! 4. `travels`: the motor model gives each burst's travel, the drift and the noise of the sensor.
//! 5. [`fit_recording`] does 3 and 4 and fits the motor's gains as every calibration does.
//!
//! `simulated` makes the recording that a laser would make of a simulated motor. Nothing here opens a file.
//!
//! Invariant: a recording that does not follow the plan's bursts gives no gains.

mod align;
mod columns;
mod error;
mod played;
mod recording;
mod simulated;
mod travels;

pub use align::Figure;
pub use columns::Layout;
pub use error::{LaserError, MAX_CLOCK_PPM, MAX_RECORDING_BYTES, MAX_SAMPLES, MAX_SECONDS, RecordingError};
pub use meissner_samples::table::{LengthUnit, TimeUnit};
pub use played::{BurstDirection, LASER, MAX_PLAN_BYTES, PlanFileError, PlayedBurst, PlayedOn, PlayedPlan};
pub use recording::{Recording, Sample};
pub use simulated::{Sensor, simulated_recording};
pub use travels::TracePoint;

use crate::calibrate::calibration::{Calibration, CalibrationError};
use crate::calibrate::fit::{MotorFit, fit};
use crate::calibrate::laser::align::Alignment;
use crate::calibrate::laser::error::{MOST_SCATTER, SLOWEST_S};
use crate::calibrate::laser::travels::Measured;
use crate::calibrate::plan::{Plan, PlanError, farthest_pulses, pulses_range};
use firmware_protocol::stroke::Direction;
use meissner_array::spec::Array;
use serde::Serialize;

/// Default numbers of pulses, as multiples of the fewest, or of more where those of [`Plan::of`] are more. The short burst makes the offset of the line certain, which makes its slope
/// more certain: the error is 1.3 times that of a line through the origin. The others are near the paper's 70: longer ones move the
/// pin further from rest and make nothing more certain, because scatter is a share of the travel.
const PULSES: [u16; 10] = [1, 5, 6, 7, 8, 9, 10, 11, 12, 13];
/// Default rounds: two and a half minutes, which give gains to 0.6 %, one standard error, at 10 % scatter.
pub const LASER_REPETITIONS: u16 = 5;

/// The share of a plan's measured bursts that a recording must cover.
const LEAST_COVERED: f64 = 0.5;

/// The plan for one motor of this array and a laser, with these numbers of pulses and repetitions or the defaults.
///
/// # Errors
/// As [`Plan::new`].
pub fn laser_plan(
    array: Array,
    motor: u8,
    pulses: Option<&[u16]>,
    repetitions: Option<u16>,
) -> Result<Plan, PlanError> {
    let default = default_pulses(array);
    Plan::new(array, Some(motor), pulses.unwrap_or(&default), repetitions.unwrap_or(LASER_REPETITIONS))
}

fn default_pulses(array: Array) -> Vec<u16> {
    let (range, most_times) = (pulses_range(array), PULSES[PULSES.len() - 1]);
    let unit = (*range.start()).max(farthest_pulses(array) / 20).min(range.end() / most_times).max(1);
    let mut pulses: Vec<u16> = PULSES.iter().map(|times| (times * unit).max(*range.start())).collect();
    pulses.dedup();
    pulses.retain(|pulses| range.contains(pulses));
    pulses
}

/// What a recording says about a motor and about the sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LaserFit {
    /// The motor.
    pub motor: u8,
    /// Travel per pulse upwards over the model's.
    pub gain_up: Figure,
    /// Travel per pulse downwards over the model's.
    pub gain_down: Figure,
    /// Standard deviation of single bursts upwards, as a share of their travel, without the sensor's noise.
    pub scatter_up: Figure,
    /// The same downwards.
    pub scatter_down: Figure,
    /// Drift of the sensor, µm/s.
    pub drift_um_per_s: Figure,
    /// Noise of a sample, one standard deviation, µm.
    pub noise_um: f64,
    /// Whether the sensor counts downwards; the fit turned it round.
    pub reversed: bool,
    /// By how much the sensor's clock runs faster than the device's, ppm.
    pub clock_error_ppm: Figure,
    /// When the first burst began, by the sensor's clock, s.
    pub first_burst_s: Figure,
    /// How far the pin ended above its place before the first burst, µm; none if the recording lacks one of the two.
    pub pin_shift_um: Option<f64>,
    /// Correlation of the measured steps with the plan's.
    pub correlation: f64,
    /// Samples of the recording.
    pub samples: usize,
    /// Rows of the recording that had no value.
    pub dropouts: usize,
    /// Bursts that the recording covers.
    pub bursts_covered: usize,
    /// Bursts of the plan.
    pub bursts_planned: usize,
    /// The fit as a calibration holds it.
    #[serde(skip)]
    pub fit: MotorFit,
    /// Measured and fitted displacement, for the plot.
    #[serde(skip)]
    pub trace: Vec<TracePoint>,
}

impl LaserFit {
    /// The calibration of this motor on the plan's device.
    ///
    /// # Errors
    /// If a text of the plan is too long for the file.
    pub fn calibration(&self, played: &PlayedPlan) -> Result<Calibration, CalibrationError> {
        Calibration::new(played.array(), vec![self.fit.clone()], played.provenance())
    }
}

/// Fits the motor of a plan that was played to a recording of its pin.
///
/// # Errors
/// The first thing that is wrong with the recording.
pub fn fit_recording(played: &PlayedPlan, recording: &Recording) -> Result<LaserFit, LaserError> {
    let (array, motor) = (played.array(), played.motor());
    let step_s = recording.median_step_s();
    if step_s > SLOWEST_S {
        return Err(LaserError::TooSlow { step_s });
    }
    if let Some((um, runs)) = recording.clipped() {
        return Err(LaserError::Clipped { um, runs });
    }
    let alignment = Alignment::of(played, recording)?;
    let measured = Measured::of(played, recording, &alignment);
    let planned = played.bursts().len();
    let covered = measured.travels.len();
    if (covered as f64) < LEAST_COVERED * planned as f64 {
        return Err(LaserError::TooFew { covered, planned });
    }
    let [mut found]: [MotorFit; 1] =
        fit(array, &measured.travels)?.try_into().map_err(|_| LaserError::Nothing)?;
    let without_noise = |direction: Direction| {
        let fit = found.of(direction);
        let noise = measured.relative_variance(direction);
        let scatter = (fit.relative_sd.powi(2) - noise).max(0.0).sqrt();
        // The standard deviation of a standard deviation; the line takes two degrees of freedom.
        let sd = fit.relative_sd / (2.0 * (fit.bursts as f64 - 2.0)).sqrt();
        Figure { value: scatter, sd }
    };
    let [scatter_up, scatter_down] = [Direction::Up, Direction::Down].map(without_noise);
    for (up, scatter) in [(true, scatter_up), (false, scatter_down)] {
        if scatter.value > MOST_SCATTER {
            return Err(LaserError::Scatter { up, scatter: scatter.value });
        }
    }
    (found.up.relative_sd, found.down.relative_sd) = (scatter_up.value, scatter_down.value);
    let gain = |direction: Direction| {
        let fit = found.of(direction);
        let value = fit.gain(array.motor());
        Figure { value, sd: fit.slope_se_um_per_pulse / fit.slope_um_per_pulse * value }
    };
    Ok(LaserFit {
        motor,
        gain_up: gain(Direction::Up),
        gain_down: gain(Direction::Down),
        scatter_up,
        scatter_down,
        drift_um_per_s: measured.drift_um_per_s,
        noise_um: measured.noise_um,
        reversed: alignment.sign < 0.0,
        clock_error_ppm: alignment.clock_error_ppm(),
        first_burst_s: alignment.first_burst_s(),
        pin_shift_um: measured.pin_shift_um,
        correlation: alignment.correlation,
        samples: recording.samples().len(),
        dropouts: recording.dropouts(),
        bursts_covered: covered,
        bursts_planned: planned,
        fit: found,
        trace: measured.trace,
    })
}
