//! The numbers of the motor model, and the range of drives that it takes.

use crate::units::TICKS_PER_S;

/// The window of the moving average, half ticks: the paper's 4.3 ms, 365.5 ticks.
pub const WINDOW_HALF_TICKS: u64 = 731;

/// The window in ticks, as a number for equations: 365.5.
pub const WINDOW_LENGTH_TICKS: f64 = WINDOW_HALF_TICKS as f64 / 2.0;

/// Whole ticks after which a shaft has followed its commanded position: 366.
pub const WINDOW_TICKS: u64 = WINDOW_HALF_TICKS.div_ceil(2);

/// Rest after which a motor's first burst is transient, ticks: half a second (the paper's Fig. 2).
pub const TRANSIENT_REST_TICKS: u64 = TICKS_PER_S / 2;

/// Mean gain of a transient burst (the paper's Fig. 2).
pub const TRANSIENT_GAIN: f64 = 0.8;

/// The fastest drive, Hz: one pulse up and one pulse down in turn.
pub const MAX_FREQUENCY_HZ: f64 = 42_500.0;

/// The largest amplitude that the model takes, µm: a metre. Patterns are limited to far less.
pub const MAX_AMPLITUDE_UM: f64 = 1e6;

/// A drive that the model does not take.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MotorError {
    /// Zero, negative, not a number, or faster than one pulse each way.
    #[error("frequency {hz} Hz: must be above 0 and at most {MAX_FREQUENCY_HZ} Hz, half the pulse rate")]
    Frequency {
        /// The value that was refused.
        hz: f64,
    },
    /// Negative, not a number, or beyond a metre.
    #[error("amplitude {um} um: must be 0 to {MAX_AMPLITUDE_UM} um, peak to peak")]
    Amplitude {
        /// The value that was refused.
        um: f64,
    },
    /// Outside one cycle.
    #[error("phase {cycles}: must be at least 0 and below 1 cycle")]
    Phase {
        /// The value that was refused.
        cycles: f64,
    },
}
