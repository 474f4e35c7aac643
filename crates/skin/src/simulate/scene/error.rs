//! What can be wrong with a scene, said in one line: what, where, what to do.
//!
//! A check knows the key, its callers where that stands (`drives[3].frequency_hz`), the reader the file. Text taken
//! from a file is quoted and cut, so that it cannot break the line.
//!
//! Invariant: the display of a [`SceneError`] holds no line break.

use meissner_array::motor::MotorError;
use meissner_input::document;
use meissner_input::message::figure;

/// A scene that was refused.
pub type SceneError = document::Refused<Problem>;

/// What is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a scene in {language} has at most {most}{advice}")]
    TooLarge { bytes: usize, language: &'static str, most: usize, advice: &'static str },
    #[error("neither `receptors` nor `population` is there: add one of them")]
    NoReceptors,
    #[error("`receptors` and `population` are both there: leave one out")]
    TwoPopulations,
    #[error("{0}")]
    Wave(#[source] MotorError),
    #[error("is {}: must be above start_s, which is {}", figure(*.stop_s), figure(*.start_s))]
    StopsBeforeStart { start_s: f64, stop_s: f64 },
    #[error(
        "motor {motor} is still driven by drives[{other}]: stop that by {start_s} s, or start this one later"
    )]
    Overlap { motor: u8, other: usize, start_s: f64 },
}

/// A problem on its way to its place.
pub(super) type Fault = document::Fault<Problem>;
