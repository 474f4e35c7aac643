//! The error of a refused scene, in one line: what is wrong, where, and what to do.
//!
//! A check knows the key, its callers know the path to it (`drives[3].frequency_hz`), the reader knows the file. Text from
//! a file is quoted and cut, so it cannot break the line.
//!
//! Invariant: the display of a [`SceneError`] holds no line break.

use meissner_array::motor::MotorError;
use meissner_array::spec::UnknownArray;
use meissner_input::document;
use meissner_input::message::short_number;

/// A scene that was refused.
pub type SceneError = document::DocumentError<Problem>;

/// What is wrong with a scene, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a scene in {language} has at most {most}{advice}")]
    TooLarge { bytes: usize, language: &'static str, most: usize, advice: &'static str },
    #[error("neither `afferents` nor `population` is there: add one of them")]
    NoAfferents,
    #[error("`afferents` and `population` are both there: leave one out")]
    TwoPopulations,
    #[error("is unknown: {0}")]
    Array(#[source] UnknownArray),
    #[error("{0}")]
    Wave(#[source] MotorError),
    #[error("is {}: must be above start_s, which is {}", short_number(*.stop_s), short_number(*.start_s))]
    StopsBeforeStart { start_s: f64, stop_s: f64 },
    #[error(
        "motor {motor} is still driven by drives[{other}]: stop that by {start_s} s, or start this one later"
    )]
    Overlap { motor: u8, other: usize, start_s: f64 },
    #[error("is afferents: this command knows the model membrane alone; `meissner simulate` knows both")]
    MembraneOnly,
    #[error("holds parameters of the model membrane: leave it out, or take that model (--model membrane)")]
    MembraneKey,
    #[error(
        "`pins` and `drives` are both there: keep `pins` (each moves by a formula) or `drives` (motors move them)"
    )]
    PinsAndDrives,
    #[error("belongs to `pins`: with `drives` the pins have been pressed in before the scene; leave it out")]
    PinsOnly,
    #[error("is {row}: {class} afferents have the rows 0 to {most}")]
    Row { row: u64, class: &'static str, most: usize },
    #[error("there are {pins} pins: must be at most {most}")]
    ManyPins { pins: usize, most: usize },
    #[error(
        "lies within a radius, {radius_mm} mm, of pins[{first}]: their loads cannot be told apart; move one of them"
    )]
    SamePlace { first: usize, radius_mm: f64 },
    #[error("stand so close that their loads cannot be told apart: leave some out, or move them apart")]
    Crowded,
}

/// A problem whose place in the file is not complete yet.
pub(crate) type KeyError = document::KeyError<Problem>;
