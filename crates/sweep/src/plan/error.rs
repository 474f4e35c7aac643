//! Errors of plans: one line that says what is wrong, where, and what to do.
//!
//! `meissner_input` has the errors that any document may have; this module has those of axes, counts and documents.

use super::{MOST_CELLS, MOST_VALUES};
use meissner_input::document;

/// The error of a refused plan.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(transparent)]
pub struct PlanError(#[from] Box<document::DocumentError<PlanProblem>>);

/// What is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum PlanProblem {
    #[error("is no axis of command = \"{command}\": did you mean `{nearest}`?")]
    UnknownAxis { command: &'static str, nearest: &'static str },
    #[error("is no axis of command = \"{command}\": leave it out; its axes are {axes}")]
    OtherCommand { command: &'static str, axes: String },
    #[error("is missing: command = \"{command}\" needs it in [grid] or [[points]]")]
    MissingAxis { command: &'static str },
    #[error("is in {there}, too: leave one out")]
    Twice { there: &'static str },
    #[error("has no value, so the sweep has no cell: add a value, or leave the axis out")]
    NoValue,
    #[error("has other axes than the first of [[points]]: name the same in each")]
    OtherPoint,
    #[error("is {found}: must be {wanted}")]
    Value { found: String, wanted: String },
    #[error("is no range: {wanted}")]
    Spread { wanted: &'static str },
    #[error("has {count} values: must be at most {MOST_VALUES}")]
    ManyValues { count: String },
    #[error("is there, but no axis is: add one to [random], or leave `[random]` out")]
    NoRandomAxis,
    #[error("{count} cells are too many: a plan has at most {MOST_CELLS}; take fewer values or samples")]
    ManyCells { count: String },
    #[error("names the {kind} {name}: {why}")]
    Document { kind: &'static str, name: String, why: String },
    #[error(
        "was made by meissner {made} (model {model}), and this is {this}: run it with that version, or make it again from its plan"
    )]
    OtherProgram { made: String, model: i64, this: String },
}

/// A problem whose place is not yet known.
pub(super) type KeyError = document::KeyError<PlanProblem>;
