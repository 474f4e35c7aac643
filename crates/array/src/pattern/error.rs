//! The errors of patterns. Each message is one line: what is wrong, where, and what to do.
//!
//! Errors that any document can have are in [`document`].
//!
//! Invariant: the display of a [`PatternError`] holds no line break.

use super::limits::{FORMAT, MAX_DRIVES, MAX_FILE_BYTES};
use crate::spec::UnknownArray;
use meissner_input::document::{self, DocumentError, Place};
use std::fmt;

/// A pattern that was refused: what is wrong, and where.
///
/// Its message counts drives from 1, as people do: `sweep.toml:12: drive 2: ...`. The place counts them from 0.
#[derive(Clone, Debug, PartialEq)]
pub struct PatternError(pub DocumentError<Problem>);

impl fmt::Display for PatternError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DocumentError { place, problem } = &self.0;
        let in_drive = place.path.strip_prefix("drive[").and_then(|path| {
            let (index, key) = path.split_once(']')?;
            Some((index.parse::<usize>().ok()?, key.trim_start_matches('.')))
        });
        let Some((index, key)) = in_drive else { return self.0.fmt(f) };
        let place = Place { path: String::new(), ..place.clone() };
        let of_drive = Place { path: key.to_owned(), ..Place::default() };
        write!(
            f,
            "{place}: drive {}: {}",
            index + 1,
            DocumentError { place: of_drive, problem: problem.clone() }
        )
    }
}

impl std::error::Error for PatternError {}

/// What can be wrong with a pattern only.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a pattern file has at most {MAX_FILE_BYTES}")]
    TooLarge { bytes: usize },
    #[error("is {found}: this version reads format = {FORMAT}")]
    Format { found: i64 },
    #[error("is {found}: must be 1 to 64 of a-z, 0-9 and -")]
    Name { found: String },
    #[error("is {stop_s}: must be above start_s, which is {start_s}")]
    StopsBeforeStart { start_s: f64, stop_s: f64 },
    #[error("is {found}: beyond the pattern's end; lower it, or raise duration_s from {duration_s}")]
    BeyondDuration { found: f64, duration_s: f64 },
    #[error(
        "is {motor}, which drive {other} still drives: stop that one by {start_s} s, or start this one later"
    )]
    Overlap { motor: u8, other: usize, start_s: f64 },
    #[error("{count} drives are too many: a pattern has at most {MAX_DRIVES}")]
    TooManyDrives { count: usize },
    #[error("holds more than {most} {what}: leave some out, or keep them in a file of their own")]
    LargeProvenance { what: &'static str, most: usize },
    #[error("is unknown: {0}")]
    Array(UnknownArray),
    #[error(
        "drives no pin near a pin of {array}: its pins stand elsewhere, so nothing would move; make the pattern for that array"
    )]
    Elsewhere { array: &'static str },
    #[error("holds a date at {key}: leave it out, or quote it as a string")]
    Date { key: String },
}

/// A problem with a key of a pattern.
pub(super) type KeyError = document::KeyError<Problem>;
