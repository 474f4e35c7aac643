//! The errors of patterns. Each message is one line: what is wrong, where, and what to do.
//!
//! Errors that any document can have are in [`document`].
//!
//! Invariant: the display of a [`PatternError`] holds no line break.

use super::limits::{
    FORMAT, MAX_AT_ONCE, MAX_DRIVES, MAX_FILE_BYTES, MAX_HOLD_S, MAX_MOTIONS, MAX_PACKED_BYTES,
    MAX_PATTERN_SAMPLES, MAX_SOURCE,
};
use super::motion::Motion;
use crate::motion::MotionError;
use crate::spec::UnknownArray;
use meissner_input::document::{self, DocumentError, Place};
use std::fmt;

/// A pattern that was refused: what is wrong, and where.
///
/// Its message counts drives and motions from 1, as people do: `sweep.toml:12: drive 2: ...`. The place counts them from 0.
#[derive(Clone, Debug, PartialEq)]
pub struct PatternError(pub DocumentError<Problem>);

impl fmt::Display for PatternError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DocumentError { place, problem } = &self.0;
        let in_table = place.path.split_once('[').and_then(|(table, rest)| {
            let (index, key) = rest.split_once(']')?;
            let is_known = table == "drive" || Motion::TABLES.contains(&table);
            is_known.then_some((table, index.parse::<usize>().ok()?, key.trim_start_matches('.')))
        });
        let Some((table, index, key)) = in_table else { return self.0.fmt(f) };
        let place = Place { path: String::new(), ..place.clone() };
        let of_table = Place { path: key.to_owned(), ..Place::default() };
        let error = DocumentError { place: of_table, problem: problem.clone() };
        write!(f, "{place}: {table} {}: {error}", index + 1)
    }
}

impl std::error::Error for PatternError {}

impl PatternError {
    /// Whether the text has too many bytes.
    pub const fn is_too_large(&self) -> bool {
        let problem = &self.0.problem;
        matches!(problem, document::Problem::Own(Problem::TooLarge { .. } | Problem::TooLargePacked { .. }))
    }
}

/// What can be wrong with a pattern only.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a pattern file has at most {MAX_FILE_BYTES}")]
    TooLarge { bytes: usize },
    #[error("{bytes} bytes are too many: a pattern file with packed samples has at most {MAX_PACKED_BYTES}")]
    TooLargePacked { bytes: usize },
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
    #[error("{count} motions are too many: a pattern has at most {MAX_MOTIONS}")]
    TooManyMotions { count: usize },
    #[error(
        "the pattern has more than {MAX_PATTERN_SAMPLES} samples with this one: make it shorter, or lower rates"
    )]
    TooManySamples,
    #[error(
        "the pattern's noise takes too long to make: make it shorter or its bands narrower, or give its samples"
    )]
    MuchNoise,
    #[error("is {found}: must be 0 to 9223372036854775807")]
    Seed { found: u64 },
    #[error("is longer than {MAX_SOURCE} bytes: make it shorter")]
    LongSource,
    #[error("needs one of um, samples and file, and only one")]
    OneOfThree,
    #[error("is for samples of a file: leave it out")]
    OfFile,
    #[error("needs rms_um or peak_um, and only one")]
    Strength,
    #[error("is {file}: pack it first: `meissner pattern pack FILE`")]
    NotPacked { file: String },
    #[error("motor {motor}: {file}: {message}")]
    File { motor: u8, file: String, message: String },
    #[error("motor {motor}: {error}")]
    Motion { motor: u8, error: Box<MotionError> },
    #[error("motor {motor}: sample {number} at {at_s} s is {um}: must be a number")]
    Sample { motor: u8, number: usize, at_s: f64, um: f64 },
    #[error("motor {motor} goes to {um:.3} um at {at_s} s{of}: must be 0 to {most_um} um")]
    Leaves { motor: u8, um: f64, at_s: f64, of: Box<str>, most_um: f64 },
    #[error("motor {motor} moves until {end_s} s: make it shorter, or raise duration_s from {duration_s}")]
    EndsLate { motor: u8, end_s: f64, duration_s: f64 },
    #[error("motor {motor} has more than {MAX_AT_ONCE} motions at {at_s} s: add some up as one wave")]
    AtOnce { motor: u8, at_s: f64 },
    #[error(
        "motor {motor} needs {from_s:.4} to {until_s:.4} s for it, and drive {drive} plays then: stop that one earlier, or start it later"
    )]
    Crosses { motor: u8, drive: usize, from_s: f64, until_s: f64 },
    #[error(
        "motor {motor} stays at one height for {seconds} s from {from_s} s on: must be at most {MAX_HOLD_S} s"
    )]
    LongHold { motor: u8, from_s: f64, seconds: f64 },
    #[error("holds more than {most} {what}: leave some out, or keep them in a file of their own")]
    LargeProvenance { what: &'static str, most: usize },
    #[error("is unknown: {0}")]
    Array(UnknownArray),
    #[error("holds a date at {key}: leave it out, or quote it as a string")]
    Date { key: String },
}

/// A problem with a key of a pattern.
pub(super) type KeyError = document::KeyError<Problem>;
