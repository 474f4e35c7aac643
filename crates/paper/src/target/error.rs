//! Errors of target files: one line that says what is wrong, where, and what to do.
//!
//! [`document`] has the errors that any file may have; this module has those of shapes and afferents.
//!
//! Invariant: the text of a [`TargetError`] has no line break.

use crate::target::limits::MAX_BYTES;
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
    #[error("{bytes} bytes are too many: a target file has at most {MAX_BYTES}")]
    TooLarge { bytes: usize },
    #[error("is {found}: must be 1 to 64 of a-z, 0-9 and -")]
    Name { found: String },
    #[error("is unknown: {0}")]
    Array(#[source] UnknownArray),
    #[error("is a key of shape = {of}, and this is a {shape}: leave it out, or change `shape`")]
    Foreign { of: &'static str, shape: &'static str },
    #[error("is a list of {count}: must be {wanted}")]
    Count { count: usize, wanted: &'static str },
    #[error("is {found}: must be a letter a to z, or a six-dot Braille character, U+2801 to U+283F")]
    Character { found: String },
    #[error("is there, but `[motion]` has its own: leave it out")]
    DurationOfMotion,
    /// A point off the pad: `dot` is its number in a Braille character, `frame` the frame and their count, if several.
    #[error(
        "{}is at [{}, {}] mm{}: must be on the pad, an ellipse {PAD_WIDTH_MM} mm wide and {PAD_LENGTH_MM} mm \
         long about the array's middle",
        dot_number(*.dot), number(.at[0]), number(.at[1]), in_frame(*.frame)
    )]
    OffPad { dot: Option<u8>, at: [f64; 2], frame: Option<(usize, usize)> },
    #[error(
        "is {reach_mm}: none of the {of} afferents is within reach of the shape{}; raise it, or take another \
         population.seed",
        in_frame(*.frame)
    )]
    NoneOn { of: usize, frame: Option<(usize, usize)>, reach_mm: f64 },
    #[error("is {reach_mm}: all {of} afferents are within reach of the shape{}; lower it", in_frame(*.frame))]
    AllOn { of: usize, frame: Option<(usize, usize)>, reach_mm: f64 },
}

fn dot_number(dot: Option<u8>) -> String {
    dot.map_or_else(String::new, |dot| format!("dot {dot} "))
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
