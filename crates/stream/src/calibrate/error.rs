//! What can be wrong with a calibration, said in one line: what, where, what to do.
//!
//! What may be wrong with any file of keys is `keyed`'s; here are the mistakes of calibrations.
//!
//! Invariant: the display of a [`CalibrationError`] holds no line break.

use super::file::{FORMAT, MAX_BYTES, MAX_WORDS};
use super::plan::PlanError;
use meissner_array::units::UM_PER_PULSE;
use meissner_input::document;
use meissner_input::message::figure;

/// A calibration that was refused.
pub type CalibrationError = document::Refused<Problem>;

/// What is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a calibration file has at most {MAX_BYTES}")]
    TooLarge { bytes: usize },
    #[error("is {found}: this version reads format = {FORMAT}")]
    Format { found: u64 },
    #[error("is empty: calibrate one at least")]
    NoMotor,
    #[error("is {motor}, and motor[{other}] is the same: leave one out")]
    Twice { motor: u8, other: usize },
    #[error("is {}: by slope_um_per_pulse it is {}; change neither by hand, calibrate again", figure(*.found), figure(*.slope))]
    Gain { found: f64, slope: f64 },
    #[error("is {}: this version's model has {UM_PER_PULSE}, for which gains are different ones; calibrate again", figure(*.found))]
    Model { found: f64 },
    #[error("is no plan's: {0}")]
    Plan(#[source] PlanError),
    #[error("is {found}: by pulses and repetitions there are {groups}")]
    Groups { found: u64, groups: usize },
    #[error("is {count} characters long: must be at most {MAX_WORDS}")]
    Words { count: usize },
}

/// A problem on its way to its place.
pub(super) type Fault = document::Fault<Problem>;
