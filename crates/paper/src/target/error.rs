//! Errors of objects that a search takes: one line that says what is wrong, where, and what to do.
//!
//! [`document`] has the errors that any file may have; `meissner-touch` has those of shapes, this module has those of a search.
//!
//! Invariant: the text of a [`TargetError`] has no line break.

use crate::target::limits::MAX_POINTS;
use meissner_array::spec::UnknownArray;
use meissner_input::document::{self, in_range};
use meissner_input::message::short_number;
use meissner_skin::membrane::{PAD_LENGTH_MM, PAD_WIDTH_MM};
use std::ops::RangeInclusive;

/// The error of a refused target.
pub type TargetError = document::DocumentError<Problem>;

/// What is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error(transparent)]
    Object(#[from] meissner_touch::Problem),
    #[error("is {found}: must be 1 to 64 of a-z, 0-9 and -")]
    Name { found: String },
    #[error("is unknown: {0}")]
    Array(#[source] UnknownArray),
    #[error("has {count} points: a search takes at most {MAX_POINTS}")]
    Count { count: usize },
    #[error("is a path, and a search follows none: add [motion] with duration_s, speed_mm_s or turn_deg_s")]
    Path,
    #[error("is there, but `[{of}]` has its own: leave it out")]
    DurationOfMotion { of: &'static str },
    /// A point off the pad; `frame` is the frame and their count, if several.
    #[error(
        "has a point at [{}, {}] mm{}: must be on the pad, an ellipse {PAD_WIDTH_MM} mm wide and {PAD_LENGTH_MM} mm \
         long about the array's middle",
        number(.at[0]), number(.at[1]), in_frame(*.frame)
    )]
    OffPad { at: [f64; 2], frame: Option<(usize, usize)> },
    #[error(
        "is {reach_mm}: none of the {of} afferents is within reach of the shape{}; raise it, or take another \
         population.seed",
        in_frame(*.frame)
    )]
    NoneOn { of: usize, frame: Option<(usize, usize)>, reach_mm: f64 },
    #[error("is {reach_mm}: all {of} afferents are within reach of the shape{}; lower it", in_frame(*.frame))]
    AllOn { of: usize, frame: Option<(usize, usize)>, reach_mm: f64 },
}

fn in_frame(frame: Option<(usize, usize)>) -> String {
    frame.map_or_else(String::new, |(frame, of)| format!(" in frame {frame} of {of}"))
}

/// A computed number for a message, to four decimals.
pub(super) fn number(value: f64) -> String {
    short_number((value * 1e4).round() / 1e4)
}

/// A problem whose place is not yet known.
pub(super) type KeyError = document::KeyError<Problem>;

/// Refuses a number outside its range.
pub(super) fn within(
    key: &str,
    found: f64,
    wanted: &RangeInclusive<f64>,
    range: &'static str,
) -> Result<(), KeyError> {
    in_range(key, found, wanted.contains(&found), range)
}
