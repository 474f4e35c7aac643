//! The range of drives that the motor model takes. The numbers of a motor are in its array's description.

/// The largest amplitude that the model takes, µm: a metre. Patterns are limited to far less.
pub const MAX_AMPLITUDE_UM: f64 = 1e6;

/// A drive that the model does not take.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MotorError {
    /// Zero, negative, not a number, or faster than one pulse each way.
    #[error("frequency {hz} Hz: must be above 0 and at most {most_hz} Hz, half the pulse rate")]
    Frequency {
        /// The value that was refused.
        hz: f64,
        /// The largest one.
        most_hz: f64,
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
