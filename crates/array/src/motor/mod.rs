//! The motor model: a square-wave drive becomes bursts of pulses, and bursts become the displacement of a shaft.
//!
//! A burst ramps the shaft's commanded position r by [`um_per_pulse`](crate::spec::MotorSpec) per tick. The shaft's displacement
//! follows r as a moving average, in the paper over 4.3 ms ([`Shaft`]). A drive is a square wave
//! whose edges are rounded to ticks ([`SquareWave`]); [`SteadyState`] gives its steady amplitude, [`hand_vibration`] its weighted
//! acceleration. This is the ideal motor: scatter, asymmetry and end stops are in [`simulated`](crate::simulated). The motor's
//! numbers are in the array's description ([`spec`](crate::spec)).
//!
//! Invariant: instants are integers (half ticks), so equal instants compare equal, nothing is lost however late it is,
//! and a shaft whose pulses cancel rests at exactly 0.

pub mod hand_vibration;
mod model;
mod shaft;
mod steady;
mod wave;

pub use model::{MAX_AMPLITUDE_UM, MotorError};
pub(crate) use shaft::Path;
pub use shaft::{HalfTick, Ramp, Shaft};
pub use steady::SteadyState;
pub use wave::{Excursion, SquareWave};
