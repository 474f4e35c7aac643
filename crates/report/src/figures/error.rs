//! The error of a report.

use crate::motions::MotionsError;
use meissner_array::motor::MotorError;
use meissner_array::simulated::SimulatedMotorsError;
use meissner_array::strokes::StrokesError;
use meissner_design::TargetError;
use meissner_skin::{FingerError, MethodError, RampsError, SceneError};
use meissner_stream::calibrate::{FitProblem, PlanError};
use meissner_touch::ContactError;

/// A figure could not be made. It is our bug, because patterns have been checked, unless the array's bursts have no room in the plan of
/// a calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum FiguresError {
    #[error("internal error: {0}")]
    Motor(#[from] MotorError),
    #[error("internal error: {0}")]
    Strokes(#[from] StrokesError),
    #[error("cannot calibrate this array: {0}")]
    Plan(#[from] PlanError),
    #[error("internal error: {0}")]
    Fit(#[from] FitProblem),
    #[error("internal error: {0}")]
    Motors(#[from] SimulatedMotorsError),
    #[error("internal error: {0}")]
    Scene(#[from] SceneError),
    #[error("internal error: {0}")]
    Method(#[from] MethodError),
    #[error("internal error: {0}")]
    Finger(#[from] FingerError),
    #[error("internal error: {0}")]
    Target(#[from] TargetError),
    #[error("internal error: {0}")]
    Motions(#[from] MotionsError),
    #[error("cannot touch the object in the provenance: {0}")]
    Contact(#[from] ContactError),
    #[error("cannot simulate the pattern: {0}")]
    Ramps(#[from] RampsError),
}
