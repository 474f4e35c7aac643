//! Pins that follow any motion: waveforms of displacement, and the moves that follow them.
//!
//! A [`Waveform`] says how high a pin should be at each instant: recorded samples, a [`RampHold`], a [`Tone`], [`Noise`], or a sum of
//! these. `strokes` compiles it to moves at exact ticks on a [`Grid`] that all motors of a play share. [`Reached`] says beforehand what
//! the motor will do: its error, where it is too slow, how many moves it needs. Nothing here reads a file or knows a play.
//!
//! Invariant: instants are whole nanoseconds or ticks, each computed from its number, so a waveform is as exact after hours as in the
//! first second; and a motor's last move always ends at rest.
//!
//! ```
//! use meissner_array::pattern::Pattern;
//! use meissner_array::strokes::{StrokeOptions, Strokes};
//!
//! let text = r#"
//!     format = 1
//!     name = "press"
//!     [[ramp]]
//!     motor = 9
//!     to_um = 100.0
//!     rise_s = 0.1
//!     hold_s = 0.8
//!     shape = "cosine"
//!     [[tone]]
//!     motor = 9
//!     start_s = 0.1
//!     duration_s = 0.8
//!     frequency_hz = 10.0
//!     end_hz = 80.0
//!     amplitude_um = 20.0
//!     about_um = 0.0
//!     envelope = "hann"
//! "#;
//! let pattern = Pattern::parse(text, "press.toml")?;
//! let strokes = Strokes::new(&pattern, &StrokeOptions::default())?;
//! let [followed] = &strokes.followed()[..] else { panic!("one motor") };
//! assert_eq!((followed.grid.step_ticks, followed.moves.last().unwrap().level), (170, 0));
//! let reached = &followed.reached;
//! assert!(reached.step_error_um < 0.95 && reached.from_filtered.share < 0.01 && reached.too_slow_s.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod generate;
mod moves;
mod reached;
mod waveform;

pub use error::MotionError;
pub(crate) use generate::MOST_NOISE_WORK;
pub use generate::{Envelope, Named, Noise, RampHold, Shape, Tone};
pub use moves::{Grid, LEAST_ERROR_UM, TRIED_S};
pub(crate) use moves::{Rule, SLOWEST_STEP_MS, STEPS_MS};
pub(crate) use reached::steps_within;
pub use reached::{Deviation, Reached};
pub use waveform::{Knot, MAX_KNOTS, MAX_SAMPLES, RATE_HZ, Section, Waveform};
pub(crate) use waveform::{ns_at, ns_of, s_of, tick_of};

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn noise(low_hz: f64, high_hz: f64, rms_um: f64, seed: u64) -> Noise {
        let (motor, start_s, duration_s, rms_um) = (0, 0.0, 2.0, Some(rms_um));
        let (peak_um, about_um, envelope) = (None, None, None);
        Noise { motor, start_s, duration_s, low_hz, high_hz, rms_um, peak_um, about_um, seed, envelope }
    }

    pub(super) fn tone(
        frequency_hz: f64,
        end_hz: f64,
        amplitude_um: f64,
        envelope: Option<Envelope>,
    ) -> Tone {
        let (motor, start_s, duration_s, end_hz) = (0, 0.0, 1.0, Some(end_hz));
        let (about_um, phase) = (None, 0.0);
        Tone { motor, start_s, duration_s, frequency_hz, end_hz, amplitude_um, about_um, phase, envelope }
    }

    pub(super) fn ramp(to_um: f64, rise_s: f64) -> RampHold {
        let (motor, start_s, hold_s, fall_s, shape) = (0, 0.1, 0.2, None, Shape::Linear);
        RampHold { motor, start_s, to_um, rise_s, hold_s, fall_s, shape }
    }
}
