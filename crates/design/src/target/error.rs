//! What can be wrong with a target, said in one line: what, where, what to do.
//!
//! What may be wrong with any file of keys is `keyed`'s; here are the mistakes of shapes.
//!
//! Invariant: the display of a [`TargetError`] holds no line break.

use super::MAX_BYTES;
use meissner_input::document;
use meissner_input::message::short_number;
use meissner_skin::TwoNames;
use meissner_skin::afferent::{PAD_LENGTH_MM, PAD_WIDTH_MM};

/// A target that was refused.
pub type TargetError = document::DocumentError<Problem>;

/// What is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a target file has at most {MAX_BYTES}")]
    TooLarge { bytes: usize },
    #[error("is {found}: must be 1 to 64 of a-z, 0-9 and -")]
    Name { found: String },
    #[error("is a key of shape = {of}, and this is a {shape}: leave it out, or change `shape`")]
    Foreign { of: &'static str, shape: &'static str },
    #[error("is a list of {count}: must be {wanted}")]
    Count { count: usize, wanted: &'static str },
    #[error("is {found}: must be a letter a to z, or a six-dot Braille character, U+2801 to U+283F")]
    Character { found: String },
    #[error("is there, and `[motion]` has its own: leave it out")]
    DurationOfMotion,
    #[error(transparent)]
    TwoNames(#[from] TwoNames),
    /// Of a Braille character it is a dot; frames are told as which of how many, if there are several.
    #[error(
        "{}is at [{}, {}] mm{}: must be on the pad, an ellipse {PAD_WIDTH_MM} mm wide and {PAD_LENGTH_MM} mm \
         long about the array's middle",
        which(*.dot), number(.at[0]), number(.at[1]), when(*.frame)
    )]
    OffPad { dot: Option<u8>, at: [f64; 2], frame: Option<(usize, usize)> },
    #[error(
        "is {reach_mm}: none of the {of} receptors is so near to the shape{}; raise it, or take another \
         population.seed",
        when(*.frame)
    )]
    NoneOn { of: usize, frame: Option<(usize, usize)>, reach_mm: f64 },
    #[error(
        "is {reach_mm}: all {of} receptors are so near to the shape{}, and none is left that should not fire; \
         lower it",
        when(*.frame)
    )]
    AllOn { of: usize, frame: Option<(usize, usize)>, reach_mm: f64 },
}

fn which(dot: Option<u8>) -> String {
    dot.map_or_else(String::new, |dot| format!("dot {dot} "))
}

fn when(frame: Option<(usize, usize)>) -> String {
    frame.map_or_else(String::new, |(frame, of)| format!(" in frame {frame} of {of}"))
}

/// A computed number as people read it: to a ten thousandth.
pub(super) fn number(value: f64) -> String {
    short_number((value * 1e4).round() / 1e4)
}

/// A problem on its way to its place.
pub(super) type KeyError = document::KeyError<Problem>;
