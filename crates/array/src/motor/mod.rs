//! The motor: from bursts of pulses to the displacement of a shaft, and from a square-wave drive to bursts.
//!
//! A burst ramps the shaft's commanded position r at one [`UM_PER_PULSE`](crate::units::UM_PER_PULSE) per
//! tick; the shaft follows as the moving average of r over 4.3 ms ([`Shaft`]). A drive is a square wave
//! whose edges fall on ticks ([`SquareWave`]); what it comes to in the steady state is [`SteadyState`].
//! No motor here has a number, a neighbour, scatter or an end stop: see `array` and `plant`.
//!
//! Invariant: instants are integers (half ticks), so equal instants compare equal, nothing is lost however
//! late it is, and a shaft whose pulses cancel rests at exactly 0.

mod shaft;
mod steady;
mod wave;

use crate::units::TICKS_PER_S;
pub use shaft::{HalfTick, Ramp, Shaft};
pub use steady::SteadyState;
pub use wave::{Excursion, Excursions, SquareWave};

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

/// The fastest drive: one pulse up and one down, in turn.
pub const MAX_FREQUENCY_HZ: f64 = 42_500.0;

/// The largest amplitude the model is asked for, µm: a metre. What a pattern may ask for is far less.
pub const MAX_AMPLITUDE_UM: f64 = 1e6;

/// A drive no motor can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MotorError {
    /// Zero, negative, not a number, or faster than one pulse each way.
    #[error("frequency {hz} Hz: must be above 0 and at most {MAX_FREQUENCY_HZ} Hz, half the pulse rate")]
    Frequency {
        /// As asked for.
        hz: f64,
    },
    /// Negative, not a number, or beyond a metre.
    #[error("amplitude {um} um: must be 0 to {MAX_AMPLITUDE_UM} um, peak to peak")]
    Amplitude {
        /// As asked for.
        um: f64,
    },
    /// Outside one cycle.
    #[error("phase {cycles}: must be at least 0 and below 1 cycle")]
    Phase {
        /// As asked for.
        cycles: f64,
    },
}
