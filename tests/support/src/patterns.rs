//! Drives and patterns for the paper's array, in few words.

use meissner_array::pattern::{Drive, Pattern};
use meissner_array::spec::Array;

/// A drive from the start, without end.
pub const fn drive(motor: u8, frequency_hz: f64, amplitude_um: f64) -> Drive {
    Drive { motor, frequency_hz, amplitude_um, phase: 0.0, start_s: None, stop_s: None }
}

/// A pattern of these drives.
pub fn pattern(name: &str, duration_s: Option<f64>, drives: impl IntoIterator<Item = Drive>) -> Pattern {
    Pattern::new(Array::paper(), name, duration_s, drives.into_iter().collect(), toml::Table::new()).unwrap()
}
