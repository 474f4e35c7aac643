//! The stored calibration: the gains that were measured, and how they were measured.
//!
//! `GET /v1/calibration` answers with a [`CalibrationReport`]; [`Provenance`] also stands in the calibration file.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How a calibration was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// The kind of device, for example `mock`.
    pub device: String,
    /// The device's firmware: version and build.
    pub firmware: String,
    /// The device's serial number, or a simulated device's seed. Another device does not use this calibration.
    pub identity: String,
    /// What measured the displacements: `plant` (the simulated motors) or `device`.
    pub telemetry: String,
    /// The burst lengths that were played, pulses each.
    pub pulses: Vec<u16>,
    /// Groups of bursts per burst length.
    #[schema(minimum = 1, maximum = 50)]
    pub repetitions: u16,
    /// Groups of bursts per motor: burst lengths times repetitions.
    #[schema(minimum = 2, maximum = 100)]
    pub groups: u64,
    /// The motor model's travel per pulse, µm; a gain of 1 moves a pin this far.
    pub um_per_pulse: f64,
    /// When the calibration was measured, UTC, for example `2026-03-04T12:00:00Z`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
}

/// The bursts of one motor, direction and length that a calibration measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MeasuredPoint {
    /// Pulses of each burst.
    #[schema(minimum = 1, maximum = 200)]
    pub pulses: u16,
    /// Their mean travel in their direction, µm.
    pub travel_um: f64,
    /// Standard deviation of their travels, µm; 0 for one burst.
    pub sd_um: f64,
    /// Number of bursts.
    #[schema(minimum = 1)]
    pub bursts: u64,
}

/// The straight line through the travels of a motor's bursts in one direction: travel = `offset_um` + `slope_um_per_pulse` × pulses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FittedLine {
    /// Travel per pulse, µm per pulse.
    pub slope_um_per_pulse: f64,
    /// The line at 0 pulses, µm.
    pub offset_um: f64,
    /// Bursts that the line goes through.
    pub bursts: u64,
    /// What was measured, by length; empty if the file holds none, as files of older versions.
    #[schema(max_items = 100)]
    pub points: Vec<MeasuredPoint>,
}

/// What a calibration measured of one motor. A gain is the measured travel per pulse over the motor model's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CalibratedMotor {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// Gain upwards, a ratio.
    pub gain_up: f64,
    /// Standard error of `gain_up`, a ratio.
    pub gain_up_se: f64,
    /// Gain downwards, a ratio.
    pub gain_down: f64,
    /// Standard error of `gain_down`, a ratio.
    pub gain_down_se: f64,
    /// Standard deviation of single bursts upwards, as a share of their travel.
    pub relative_sd_up: f64,
    /// Standard deviation of single bursts downwards, as a share of their travel.
    pub relative_sd_down: f64,
    /// The line upwards, and the points that it goes through.
    pub up: FittedLine,
    /// The line downwards, and the points that it goes through.
    pub down: FittedLine,
}

/// The stored calibration, and whether the daemon uses it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "file": "/var/lib/meissner/calibration.toml",
    "used": true,
    "unused": null,
    "motors": [{
        "motor": 3, "gain_up": 0.94, "gain_up_se": 0.006, "gain_down": 0.95, "gain_down_se": 0.006,
        "relative_sd_up": 0.05, "relative_sd_down": 0.05,
        "up": {
            "slope_um_per_pulse": 0.1276, "offset_um": 0.02, "bursts": 54,
            "points": [{"pulses": 14, "travel_um": 1.81, "sd_um": 0.09, "bursts": 18}]
        },
        "down": {
            "slope_um_per_pulse": 0.1289, "offset_um": 0.01, "bursts": 54,
            "points": [{"pulses": 14, "travel_um": 1.82, "sd_um": 0.1, "bursts": 18}]
        }
    }],
    "provenance": {
        "device": "mock", "firmware": "0.1.0 (6d656973)", "identity": "mock seed 0", "telemetry": "plant",
        "pulses": [14, 70, 140], "repetitions": 2, "groups": 6, "um_per_pulse": 0.2, "date": "2026-03-04T12:00:00Z"
    },
    "toml": "format = 1\n..."
})))]
pub struct CalibrationReport {
    /// The calibration file's path.
    pub file: String,
    /// Whether the daemon corrects bursts with these gains.
    pub used: bool,
    /// Why the daemon does not use the calibration; null if it does.
    pub unused: Option<String>,
    /// The calibrated motors; a motor that is missing here has a gain of 1.
    #[schema(max_items = 64)]
    pub motors: Vec<CalibratedMotor>,
    /// How the calibration was measured.
    pub provenance: Provenance,
    /// The calibration file's text, TOML.
    pub toml: String,
}
