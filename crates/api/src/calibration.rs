//! What a calibration measured, and how it was made.

use serde::{Deserialize, Serialize};

/// How a calibration was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// The kind of device, as `mock`.
    pub device: String,
    /// Its firmware's version and build.
    pub firmware: String,
    /// Which one it is: a serial number, or a mock's seed.
    pub identity: String,
    /// What measured the displacements, as `plant`.
    pub telemetry: String,
    /// The plan's numbers of pulses.
    pub pulses: Vec<u16>,
    /// The plan's groups of each.
    pub repetitions: u16,
    /// Groups of each motor.
    pub groups: u64,
    /// The model's constant, by which gains are counted.
    pub um_per_pulse: f64,
    /// When, in the caller's words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
}

/// What a calibration found of a motor. Gains are what a pulse moves the pin by over what the model says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibratedMotor {
    /// Its number.
    pub motor: u8,
    /// Upwards.
    pub gain_up: f64,
    /// Standard error of that.
    pub gain_up_se: f64,
    /// Downwards.
    pub gain_down: f64,
    /// Standard error of that.
    pub gain_down_se: f64,
    /// Standard deviation of single bursts upwards, as a share of their travel.
    pub relative_sd_up: f64,
    /// Downwards.
    pub relative_sd_down: f64,
}

/// `GET /v1/calibration`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationReport {
    /// Where it is stored.
    pub file: String,
    /// Whether bursts are corrected by it.
    pub used: bool,
    /// Why not.
    pub unused: Option<String>,
    /// What it says of each motor that was calibrated.
    pub motors: Vec<CalibratedMotor>,
    /// What it was made by.
    pub provenance: Provenance,
    /// The file's text.
    pub toml: String,
}
