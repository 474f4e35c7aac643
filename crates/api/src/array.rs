//! The array that a daemon drives, as its description says.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The array: pins, carrier, wiring and motors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "name": "tula35-2x3", "hash": "3f0a5c1d9b7e2468",
    "positions_mm": [[-2.9, 1.45], [0.0, 1.45], [2.9, 1.45], [-2.9, -1.45], [0.0, -1.45], [2.9, -1.45]],
    "grid": {"rows": 2, "columns": 3, "pitch_mm": 2.9}, "pitch_mm": 2.9, "pin_radius_mm": 0.5,
    "tick_hz": 85000, "duty": {"up": 0.2, "down": 0.8},
    "rails": [[0, 1, 2, 3, 4, 5]], "chips": [[0, 1], [2, 3], [4, 5]],
    "motor": {"um_per_pulse": 0.1357142857142857, "window_ms": 4.3, "speed_mm_s": 11.5, "travel_um": 400.0, "least_pulses": 7,
              "most_pulses": 3000},
    "toml": "name = \"tula35-2x3\"\npins = { rows = 2, columns = 3, pitch_mm = 2.9 }\ntick_hz = 85000\nduty = { up = 0.2, down = 0.8 }\n[motor]\nstep_um = 0.1357142857142857\nwindow_ms = 4.3\ntravel_um = 400.0\nleast_pulses = 7\nmost_pulses = 3000\n"
})))]
pub struct ArrayDetails {
    /// The description's name.
    pub name: String,
    /// A hash of all values of the description, 16 hexadecimal digits: equal arrays have equal hashes.
    pub hash: String,
    /// Where each motor's pin stands, mm: x across the finger, y towards its tip. The list's index is the motor's number.
    #[schema(min_items = 1, max_items = 64)]
    pub positions_mm: Vec<[f64; 2]>,
    /// The rows and columns, if the pins stand in such: a motor's number is `columns` × row + column. Null: they stand elsewhere.
    pub grid: Option<ArrayGrid>,
    /// Smallest distance of two pins, mm.
    pub pitch_mm: f64,
    /// Radius of a pin's tip, mm.
    pub pin_radius_mm: f64,
    /// Rate of the pulses and of the ticks of the device's clock, Hz.
    #[schema(minimum = 20000, maximum = 200_000)]
    pub tick_hz: u32,
    /// The pulses' duty.
    pub duty: ArrayDuty,
    /// The motors of each supply.
    #[schema(max_items = 64)]
    pub rails: Vec<Vec<u8>>,
    /// The motors of each driver chip.
    #[schema(max_items = 64)]
    pub chips: Vec<Vec<u8>>,
    /// What its motors do.
    pub motor: ArrayMotor,
    /// The description's file, TOML.
    pub toml: String,
}

/// Pins in rows and columns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArrayGrid {
    /// Rows, from the fingertip down.
    #[schema(minimum = 1, maximum = 64)]
    pub rows: u8,
    /// Columns, across the finger.
    #[schema(minimum = 1, maximum = 64)]
    pub columns: u8,
    /// Distance of neighbouring pins, mm.
    #[schema(minimum = 0.1, maximum = 25.0)]
    pub pitch_mm: f64,
}

/// For how much of a tick a line is high.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArrayDuty {
    /// In a pulse that moves the pin up, a share.
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub up: f64,
    /// In a pulse that moves it down, a share.
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub down: f64,
}

/// What a motor does with its pulses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ArrayMotor {
    /// Travel of a shaft per pulse, µm.
    #[schema(minimum = 0.001, maximum = 10.0)]
    pub um_per_pulse: f64,
    /// The window of the moving average with which a shaft follows its pulses, ms.
    #[schema(minimum = 0.0, maximum = 500.0)]
    pub window_ms: f64,
    /// Speed of a shaft while its motor has pulses, mm/s.
    pub speed_mm_s: f64,
    /// The largest amplitude of a drive, µm peak to peak.
    #[schema(minimum = 1.0, maximum = 5000.0)]
    pub travel_um: f64,
    /// The fewest pulses of a burst for which the travel per pulse is known, pulses.
    #[schema(minimum = 1)]
    pub least_pulses: u16,
    /// The largest number of pulses of a burst up, pulses.
    #[schema(minimum = 1)]
    pub most_pulses: u16,
}
