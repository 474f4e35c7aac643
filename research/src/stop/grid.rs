//! The grid of settings.

use super::edge::array;
use meissner_array::motor::MotorError;
use meissner_array::pattern::Drive;
use meissner_array::per_motor::PerMotor;
use meissner_array::reflected_walk::Spread;
use meissner_array::simulated::{LowerStop, SimulatedMotorsConfig};
use meissner_array::strokes::{AutoSurplus, DriveStrokes, StrokeOptions, Surplus};
use serde::{Serialize, Serializer};

/// The settings to measure: every combination.
#[derive(Clone, Debug, PartialEq)]
pub struct StopGrid {
    /// Frequencies, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Amplitudes, peak to peak, µm.
    pub amplitudes_um: Vec<f64>,
    /// Standard deviations of a burst's gain.
    pub scatters: Vec<f64>,
    /// Standard deviations, over motors, of gain up minus gain down.
    pub asymmetry_sds: Vec<f64>,
    /// Surpluses. All share their random numbers, so that rows differ only by the surplus.
    pub surpluses: Vec<StopSurplus>,
    /// The bound of the worst motor's rest error under the automatic surplus, RMS, µm.
    pub rest_error_um: f64,
    /// Simulated arrays, with the seeds 0, 1, ….
    pub arrays: u64,
    /// Strokes of each motor.
    pub strokes: usize,
    /// The number of first strokes that do not count.
    pub settling: usize,
    /// The shortest play for which the response is predicted, s; it has at least two periods.
    pub response_s: f64,
}

/// How much longer down bursts are than up bursts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StopSurplus {
    /// By this many µm.
    Um(f64),
    /// The surplus that the theory computes.
    Auto,
}

/// One cell of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StopCell {
    /// Of the square wave.
    pub frequency_hz: f64,
    /// Of the square wave, peak to peak.
    pub amplitude_um: f64,
    /// Standard deviation of a burst's gain.
    pub scatter: f64,
    /// Standard deviation, over motors, of gain up minus gain down.
    pub asymmetry_sd: f64,
    /// The requested surplus of down bursts over up bursts: µm, or `auto`.
    pub surplus: StopSurplus,
}

impl Serialize for StopSurplus {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Um(um) => serializer.serialize_f64(*um),
            Self::Auto => serializer.serialize_str("auto"),
        }
    }
}

impl Default for StopGrid {
    /// 648 cells. At 60 Hz the strokes last 25 s. At 0.5 Hz every burst falls short, as after rest.
    fn default() -> Self {
        let fixed = [0.0, 8.0, 11.0, 15.0, 20.0].map(StopSurplus::Um);
        Self {
            frequencies_hz: vec![0.5, 10.0, 60.0, 150.0],
            amplitudes_um: vec![20.0, 80.0, 200.0],
            scatters: vec![0.05, 0.1, 0.2],
            asymmetry_sds: vec![0.0, 0.02, 0.05],
            surpluses: fixed.into_iter().chain([StopSurplus::Auto]).collect(),
            rest_error_um: 5.0,
            arrays: 2,
            strokes: 1500,
            settling: 300,
            response_s: 2.0,
        }
    }
}

impl StopGrid {
    /// The cells that differ in their surplus only, in order; the last setting changes first.
    pub(super) fn groups(&self) -> Vec<Vec<StopCell>> {
        let mut groups = Vec::new();
        for &frequency_hz in &self.frequencies_hz {
            for &amplitude_um in &self.amplitudes_um {
                for &scatter in &self.scatters {
                    for &asymmetry_sd in &self.asymmetry_sds {
                        let cell = |&surplus: &StopSurplus| StopCell {
                            frequency_hz,
                            amplitude_um,
                            scatter,
                            asymmetry_sd,
                            surplus,
                        };
                        groups.push(self.surpluses.iter().map(cell).collect());
                    }
                }
            }
        }
        groups
    }
}

impl StopCell {
    /// The options that the cell's drives are played with.
    pub(super) fn options(&self, rest_error_um: f64) -> StrokeOptions {
        let surplus = match self.surplus {
            StopSurplus::Um(um) => Surplus::Fixed(um),
            StopSurplus::Auto => {
                let spread = Spread::uncalibrated(self.scatter, self.asymmetry_sd, array().motors());
                let spread = PerMotor::all(array(), spread);
                Surplus::Auto(Box::new(AutoSurplus { spread, rest_error_um }))
            }
        };
        StrokeOptions { surplus, ..StrokeOptions::default() }
    }

    /// The strokes of the cell's drive.
    pub(super) fn strokes(&self, rest_error_um: f64) -> Result<DriveStrokes, MotorError> {
        let Self { frequency_hz, amplitude_um, .. } = *self;
        let drive = Drive { motor: 0, frequency_hz, amplitude_um, phase: 0.0, start_s: None, stop_s: None };
        DriveStrokes::with(array(), &drive, &self.options(rest_error_um))
    }

    /// The cell's simulated motors. They have no upper stop, because the theory has none.
    pub(super) fn motors(&self, seed: u64, lower_stop: LowerStop) -> SimulatedMotorsConfig {
        SimulatedMotorsConfig {
            seed,
            gain_sd: self.scatter,
            asymmetry_sd: self.asymmetry_sd,
            end_stop_um: f64::INFINITY,
            lower_stop,
            ..SimulatedMotorsConfig::default()
        }
    }
}
