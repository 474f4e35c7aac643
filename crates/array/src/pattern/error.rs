//! What can be wrong with a pattern, said in one line: what, where, what to do.
//!
//! A check knows the drive and the key; the file's name and line are added by who knows them. Text taken
//! from a file is quoted and cut, so that it cannot break the line.
//!
//! Invariant: the display of a [`PatternError`] holds no line break.

use super::{FORMAT, MAX_DRIVES, MAX_FILE_BYTES};
use meissner_input::message::quote;
use std::fmt;

/// A pattern that was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct PatternError {
    /// Where it is wrong.
    pub place: Place,
    /// What is wrong.
    pub problem: Problem,
}

/// A place in a pattern file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file as the caller named it.
    pub file: String,
    /// The line, from 1, if there is a file.
    pub line: Option<usize>,
    /// The drive, from 1, if it is about one.
    pub drive: Option<usize>,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.escape_debug())?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if let Some(drive) = self.drive {
            write!(f, ": drive {drive}")?;
        }
        Ok(())
    }
}

/// What is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a pattern file has at most {MAX_FILE_BYTES}")]
    TooLarge { bytes: usize },
    #[error("not TOML: {message}")]
    Syntax { message: String },
    #[error("unknown key {key}: did you mean `{nearest}`?")]
    UnknownKey { key: String, nearest: &'static str },
    #[error("`{key}` is missing: add {wanted}")]
    Missing { key: &'static str, wanted: &'static str },
    #[error("`{key}` is of type {found}: must be {wanted}")]
    Type { key: &'static str, found: &'static str, wanted: &'static str },
    #[error("`format` is {found}: this version reads format = {FORMAT}")]
    Format { found: i64 },
    #[error("`name` is {found}: must be 1 to 64 of a-z, 0-9 and -")]
    Name { found: String },
    #[error("`{key}` is {found}: must be {range}")]
    Range { key: &'static str, found: f64, range: &'static str },
    #[error("`stop_s` is {stop_s}: must be above start_s, which is {start_s}")]
    StopsBeforeStart { start_s: f64, stop_s: f64 },
    #[error("`{key}` is {found}: beyond the pattern's end; lower it, or raise duration_s from {duration_s}")]
    BeyondDuration { key: &'static str, found: f64, duration_s: f64 },
    #[error(
        "motor {motor} is still driven by drive {other}: stop that by {start_s} s, or start this one later"
    )]
    Overlap { motor: u8, other: usize, start_s: f64 },
    #[error("{count} drives are too many: a pattern has at most {MAX_DRIVES}")]
    TooManyDrives { count: usize },
    #[error("`provenance` holds a date at {key}: leave it out, or quote it as a string")]
    Date { key: String },
}

/// A problem on its way to its place.
#[derive(Debug)]
pub(super) struct Fault {
    /// Index of the drive.
    pub(super) drive: Option<usize>,
    /// The key it is about, by which its line can be found.
    pub(super) key: Option<&'static str>,
    /// Where in the text, if that is known already.
    pub(super) offset: Option<usize>,
    problem: Problem,
}

impl Fault {
    pub(super) const fn key(key: &'static str, problem: Problem) -> Self {
        Self { drive: None, key: Some(key), offset: None, problem }
    }

    pub(super) const fn offset(offset: usize, problem: Problem) -> Self {
        Self { drive: None, key: None, offset: Some(offset), problem }
    }

    pub(super) fn in_drive(self, index: usize) -> Self {
        Self { drive: Some(index), ..self }
    }

    pub(super) fn at(self, file: &str, line: Option<usize>) -> PatternError {
        let drive = self.drive.map(|index| index + 1);
        PatternError { place: Place { file: file.to_owned(), line, drive }, problem: self.problem }
    }
}

/// The key of the first date in a table, if there is one: what made a pattern does not depend on when.
pub(super) fn date_in(table: &toml::Table) -> Option<String> {
    fn is_or_holds(value: &toml::Value) -> bool {
        match value {
            toml::Value::Datetime(_) => true,
            toml::Value::Array(values) => values.iter().any(is_or_holds),
            toml::Value::Table(table) => table.values().any(is_or_holds),
            _ => false,
        }
    }
    table.iter().find(|(_, value)| is_or_holds(value)).map(|(key, _)| quote(key))
}
