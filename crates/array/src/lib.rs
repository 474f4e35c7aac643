//! The pin array and its motors, from a pattern to the displacement of each pin.
//!
//! - [`geometry`]: where the 24 pins stand.
//! - [`pattern`]: pattern files, which pins vibrate, at which frequency, amplitude and phase, and when.
//! - [`motor`]: the motor model: a square-wave drive becomes bursts of pulses, bursts become displacement.
//! - [`strokes`]: a pattern compiled to strokes at exact ticks. Streamer, simulated motors and skin model all use it.
//! - [`simulated`]: 24 simulated motors with scatter, asymmetry, end stops and telemetry.
//! - [`units`]: seconds, ticks and micrometres; [`random`]: random numbers that depend on a key alone.
//!
//! The crate opens no file and reads no clock.

pub mod geometry;
pub mod motor;
pub mod pattern;
pub mod random;
pub mod simulated;
pub mod strokes;
pub mod units;
