//! The settings of the simulated array.

use crate::motor::TRANSIENT_GAIN;
use serde::{Deserialize, Serialize};

/// The highest rate of telemetry, samples per second.
pub const MAX_TELEMETRY_HZ: u32 = 10_000;
/// The longest telemetry delay, ms.
pub const MAX_TELEMETRY_AGE_MS: u32 = 1_000;

/// How the simulated motors differ from ideal ones, and their telemetry.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatedMotorsConfig {
    /// The seed of all random numbers: it stands for one individual array.
    pub seed: u64,
    /// Standard deviation of the gain of a burst: 0.10 by the paper's Fig. 2.
    pub gain_sd: f64,
    /// Standard deviation, over motors, of the relative difference of the travel of a pulse up and down. Our choice.
    pub asymmetry_sd: f64,
    /// Mean gain of the first burst after half a second of rest: 0.8, the transient of the paper's Fig. 2.
    pub transient_gain: f64,
    /// Distance of the end stops from rest, µm. Our choice: no data sheet was found.
    pub end_stop_um: f64,
    /// Telemetry samples per second; 0: no telemetry.
    pub telemetry_hz: u32,
    /// Age of a sample when it is delivered, ms.
    pub telemetry_age_ms: u32,
}

impl Default for SimulatedMotorsConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            gain_sd: 0.10,
            asymmetry_sd: 0.02,
            transient_gain: TRANSIENT_GAIN,
            end_stop_um: 500.0,
            telemetry_hz: 1000,
            telemetry_age_ms: 1,
        }
    }
}

impl SimulatedMotorsConfig {
    /// The default without scatter, asymmetry and transient: every pulse follows the model.
    #[must_use]
    pub fn ideal() -> Self {
        Self { gain_sd: 0.0, asymmetry_sd: 0.0, transient_gain: 1.0, ..Self::default() }
    }

    /// The settings that identify the array; telemetry is left out.
    #[must_use]
    pub fn identity(&self) -> String {
        let Self { seed, gain_sd, asymmetry_sd, transient_gain, end_stop_um, .. } = self;
        format!(
            "seed {seed}, gain_sd {gain_sd}, asymmetry_sd {asymmetry_sd}, transient_gain {transient_gain}, end_stop_um \
             {end_stop_um}"
        )
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn check(&self) -> Result<(), SimulatedMotorsError> {
        let checks = [
            ("gain_sd", self.gain_sd, 1.0),
            ("asymmetry_sd", self.asymmetry_sd, 1.0),
            ("transient_gain", self.transient_gain, 2.0),
            ("end_stop_um", self.end_stop_um, 10_000.0),
            ("telemetry_hz", self.telemetry_hz.into(), MAX_TELEMETRY_HZ.into()),
            ("telemetry_age_ms", self.telemetry_age_ms.into(), MAX_TELEMETRY_AGE_MS.into()),
        ];
        match checks.into_iter().find(|&(_, found, most)| !(0.0..=most).contains(&found)) {
            Some((key, found, most)) => Err(SimulatedMotorsError { key, found, most }),
            None => Ok(()),
        }
    }
}

/// A setting outside its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("mock.{key} is {found}: must be 0 to {most}")]
pub struct SimulatedMotorsError {
    /// Which setting.
    pub key: &'static str,
    /// Its value.
    pub found: f64,
    /// Its largest allowed value.
    pub most: f64,
}
