//! What can be wrong with a calibration, said in one line: what, where, what to do.
//!
//! What may be wrong with any file of keys is `keyed`'s; here are the mistakes of calibrations.
//!
//! Invariant: the display of a [`CalibrationError`] holds no line break.

use super::file::{FORMAT, MAX_BYTES, MAX_WORDS};
use super::plan::PlanError;
use crate::keyed::{self, Mistake, Place};
use crate::quote::figure;
use crate::units::UM_PER_PULSE;

/// A calibration that was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{place}{}{problem}", .place.joint(.problem))]
pub struct CalibrationError {
    /// Where it is wrong.
    pub place: Place,
    /// What is wrong.
    pub problem: Problem,
}

/// What is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a calibration file has at most {MAX_BYTES}")]
    TooLarge { bytes: usize },
    #[error(transparent)]
    Mistake(Mistake),
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
pub(super) type Fault = keyed::Fault<Problem>;

impl From<keyed::Fault<Mistake>> for Fault {
    fn from(fault: keyed::Fault<Mistake>) -> Self {
        fault.map(Problem::Mistake)
    }
}

impl CalibrationError {
    /// `file` is what errors call it, if there is one.
    pub(super) fn new(fault: Fault, file: Option<&str>) -> Self {
        let (place, problem) = fault.placed(file);
        Self { place, problem }
    }
}
