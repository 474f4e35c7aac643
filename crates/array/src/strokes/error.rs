//! Errors of compiling a pattern to strokes.

use crate::motion::MotionError;
use crate::motor::MotorError;
use crate::pattern::MAX_SECONDS;
use crate::strokes::{Step, Stroke};
use firmware_protocol::limits::Refusal;

/// Why a pattern cannot be played, or cannot be played to its end.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StrokesError {
    /// A duration outside its range.
    #[error("{seconds} s: must be at least 0 and at most {MAX_SECONDS} s")]
    Seconds {
        /// The duration that was refused.
        seconds: f64,
    },
    /// A scale outside 0 to 1.
    #[error("scale {scale}: must be at least 0 and at most 1")]
    Scale {
        /// The scale that was refused.
        scale: f64,
    },
    /// A surplus outside its range.
    #[error("surplus {um} um: must be 0 to {most_um} um")]
    Surplus {
        /// The surplus that was refused.
        um: f64,
        /// The largest one.
        most_um: f64,
    },
    /// A rest error that no surplus can keep.
    #[error("rest error {um} um: must be above 0")]
    RestError {
        /// The rest error that was refused.
        um: f64,
    },
    /// Motions that cannot be compiled as asked.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// A drive that no motor can play.
    #[error("a drive of motor {motor}: {source}")]
    Drive {
        /// The motor.
        motor: u8,
        /// What is wrong with the drive.
        source: MotorError,
    },
    /// Our bug: a step outside the controller's limits.
    #[error("internal error, nothing more is played: {step:?} breaks the limit {refusal:?}")]
    Limit {
        /// The step.
        step: Step,
        /// The limit.
        refusal: Refusal,
    },
    /// Our bug: a stroke that does not return the pin to where it began, or pushes more against the stop than it should.
    #[error("internal error, nothing more is played: {stroke:?} is not as long down as up and the surplus")]
    Unbalanced {
        /// The stroke.
        stroke: Stroke,
    },
    /// Our bug: a step that begins before its motor's last step has ended, or before the last returned step begins.
    #[error("internal error, nothing more is played: {step:?} is out of order")]
    Order {
        /// The step.
        step: Step,
    },
}
