//! The settings of the simulated array.

use crate::spec::MotorSpec;
use serde::{Deserialize, Serialize};

/// The highest rate of telemetry, samples per second.
pub const MAX_TELEMETRY_HZ: u32 = 10_000;
/// The longest telemetry delay, ms.
pub const MAX_TELEMETRY_AGE_MS: u32 = 1_000;

/// What holds a pin at rest from below.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LowerStop {
    /// Nothing: a pin may sink below rest, down to its end stop.
    #[default]
    None,
    /// A plate at rest: a pin cannot go below 0. We assume that the friction contact of shaft and pin slips, so that the motor runs
    /// on while the pin stays; that the pin does not bounce; and that it leaves the stop with the first pulse up. These pulses do
    /// no harm, but they are counted ([`Pin::pushed_pulses`](super::Pin::pushed_pulses)).
    AtRest,
}

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
    /// Mean gain of the first burst after the rest that the array's description names; `None`: as it says there. It does nothing
    /// for an array without `transient`.
    pub transient_gain: Option<f64>,
    /// Distance of the end stops from rest, µm. Our choice: no data sheet was found.
    pub end_stop_um: f64,
    /// What holds the pins at rest from below. A stop clips the commanded position; the pin follows the clipped position through
    /// the same moving average as always.
    pub lower_stop: LowerStop,
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
            transient_gain: None,
            end_stop_um: 500.0,
            lower_stop: LowerStop::None,
            telemetry_hz: 1000,
            telemetry_age_ms: 1,
        }
    }
}

impl SimulatedMotorsConfig {
    /// The default settings without scatter, asymmetry and transient: every pulse follows the model.
    pub fn ideal() -> Self {
        Self { gain_sd: 0.0, asymmetry_sd: 0.0, transient_gain: Some(1.0), ..Self::default() }
    }

    /// Mean gain of the first burst of such a motor after a rest.
    pub fn transient_gain(&self, motor: &MotorSpec) -> f64 {
        self.transient_gain.unwrap_or(motor.transient_gain)
    }

    /// The settings that identify the array, which has such motors; telemetry is left out. Arrays without a lower stop have the
    /// identity that they had before there were stops, so that their calibrations stay valid.
    pub fn identity(&self, motor: &MotorSpec) -> String {
        let Self { seed, gain_sd, asymmetry_sd, end_stop_um, lower_stop, .. } = self;
        let transient_gain = self.transient_gain(motor);
        let stop = match lower_stop {
            LowerStop::None => "",
            LowerStop::AtRest => ", lower_stop at_rest",
        };
        format!(
            "seed {seed}, gain_sd {gain_sd}, asymmetry_sd {asymmetry_sd}, transient_gain {transient_gain}, end_stop_um \
             {end_stop_um}{stop}"
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
            ("transient_gain", self.transient_gain.unwrap_or(1.0), 2.0),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::Array;

    #[test]
    fn a_lower_stop_makes_another_array_and_none_the_same() {
        let stop =
            SimulatedMotorsConfig { lower_stop: LowerStop::AtRest, ..SimulatedMotorsConfig::default() };
        let motor = Array::paper().spec().motor();
        let none = SimulatedMotorsConfig::default().identity(motor);
        assert_eq!(none, "seed 0, gain_sd 0.1, asymmetry_sd 0.02, transient_gain 0.8, end_stop_um 500");
        assert_eq!(stop.identity(motor), format!("{none}, lower_stop at_rest"));
        assert_eq!(serde_json::to_value(stop).unwrap()["lower_stop"], "at_rest");
    }
}
