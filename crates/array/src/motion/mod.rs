//! Pins that follow any motion: waveforms of displacement, and the moves that follow them.
//!
//! A [`Waveform`] says how high a pin should be at each instant: recorded samples, a [`RampHold`], a [`Tone`], [`Noise`], or a sum of
//! these. [`Moves`] compiles it to moves at exact ticks on a [`Grid`] that all motors of a play share. [`Reached`] says beforehand what
//! the motor will do: its error, where it is too slow, how many moves it needs. Nothing here reads a file or knows a play.
//!
//! Invariant: instants are whole nanoseconds or ticks, each computed from its number, so a waveform is as exact after hours as in the
//! first second; and a motor's last move always ends at rest.

mod error;
mod generate;
mod moves;
mod reached;
mod waveform;

pub use error::MotionError;
pub use generate::{Envelope, Noise, RampHold, Shape, Strength, Tone};
pub use moves::{Compiled, Grid, Moves, compile};
pub use reached::{Deviation, Path, Reached};
pub use waveform::{Knot, MAX_KNOTS, RATE_HZ, Waveform};
