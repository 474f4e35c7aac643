//! Pins that follow any motion: waveforms of displacement, and the moves that follow them.
//!
//! A [`Waveform`] says how high a pin should be at each instant: recorded samples, a [`RampHold`], a [`Tone`], [`Noise`], or a sum of
//! these. [`Moves`] compiles it to moves at exact ticks on a [`Grid`] that all motors of a play share. [`Reached`] says beforehand what
//! the motor will do: its error, where it is too slow, how many moves it needs. Nothing here reads a file or knows a play.
//!
//! Invariant: instants are whole nanoseconds or ticks, each computed from its number, so a waveform is as exact after hours as in the
//! first second; and a motor's last move always ends at rest.
//!
//! ```
//! use meissner_array::motion::{Envelope, RampHold, Shape, Tone, Waveform, beginning, choose};
//! use meissner_array::spec::Array;
//!
//! let (start_s, to_um, rise_s, hold_s, fall_s, shape) = (0.0, 100.0, 0.1, 0.8, 0.1, Shape::Cosine);
//! let press = RampHold { start_s, to_um, rise_s, hold_s, fall_s, shape }.waveform()?;
//! let (start_s, duration_s, about_um, phase, envelope) = (0.1, 0.8, Some(0.0), 0.0, Envelope::Hann);
//! let (start_hz, end_hz, amplitude_um) = (10.0, 80.0, 20.0);
//! let chirp = Tone { start_s, duration_s, start_hz, end_hz, amplitude_um, about_um, phase, envelope }.waveform()?;
//!
//! let (array, waveform) = (Array::paper(), Waveform::sum(&[press, chirp])?);
//! let grid = choose(array, [(9, &waveform)].into_iter(), None)?;
//! let (moves, reached) = beginning(array, 9, &waveform, grid, 2_000_000_000);
//! assert_eq!((grid.step_ticks, moves.last().unwrap().level), (170, 0));
//! assert!(reached.step_error_um < 0.95 && reached.from_filtered.share < 0.01 && reached.too_slow_s.is_empty());
//! # Ok::<(), meissner_array::motion::MotionError>(())
//! ```

mod error;
mod generate;
mod moves;
mod reached;
mod waveform;

pub use error::MotionError;
pub(crate) use generate::MOST_NOISE_WORK;
pub use generate::{Envelope, Noise, RampHold, Shape, Strength, Tone};
pub use moves::{Grid, LEAST_ERROR_UM, Moves, TRIED_S, beginning, choose};
pub(crate) use moves::{Rule, SLOWEST_STEP_MS, choose_within};
pub use reached::{Deviation, Path, Reached};
pub use waveform::{Knot, MAX_KNOTS, MAX_SAMPLES, RATE_HZ, Section, Waveform};
pub(crate) use waveform::{ns_at, ns_of, s_of, tick_of};
