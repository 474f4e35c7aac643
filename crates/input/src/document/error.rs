//! The errors of documents.
//!
//! A reader finds a [`KeyError`]: a [`Problem`] with a key. With the file it becomes a [`DocumentError`]: a problem at a
//! [`Place`]. A problem is either a [`CommonProblem`], which any document can have, or one of the reader's own.
//!
//! Invariant: a [`CommonProblem`] and a [`Place`] display no line break.

use super::lines::line_of;
use crate::message::short_number;
use std::borrow::Cow;
use std::fmt;

/// A place in a document, or in a value that was made in memory.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// The file, as the caller names it.
    pub file: Option<String>,
    /// The line, from 1, if it is known.
    pub line: Option<usize>,
    /// The path of the key, as in `drives[3].frequency_hz`; lists count from 0. Empty: the whole document.
    pub path: String,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let separator = if self.file.is_some() && !self.path.is_empty() { ": " } else { "" };
        if let Some(file) = &self.file {
            write!(f, "{}", file.escape_debug())?;
        }
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if self.path.is_empty() { Ok(()) } else { write!(f, "{separator}`{}`", self.path) }
    }
}

impl Place {
    /// The text between the place and a problem: "`phase` is 2" needs only a space.
    fn separator(&self, problem: &dyn fmt::Display) -> &'static str {
        match () {
            () if *self == Self::default() => "",
            () if !self.path.is_empty() && reads_on(&problem.to_string()) => " ",
            () => ": ",
        }
    }
}

/// Whether the text of a problem continues a sentence that begins with the key.
fn reads_on(problem: &str) -> bool {
    ["is ", "are ", "has ", "have ", "holds ", "needs "].iter().any(|verb| problem.starts_with(verb))
}

/// A problem that any document can have, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum CommonProblem {
    #[error("not {language}: {message}")]
    Syntax { language: &'static str, message: String },
    #[error("unknown key {key}: did you mean `{nearest}`?")]
    UnknownKey { key: String, nearest: String },
    #[error("unknown key {key}: leave it out, no keys are known here")]
    NoKeys { key: String },
    #[error("is missing: add {wanted}")]
    Missing { wanted: &'static str },
    #[error("is there twice: leave one out")]
    Twice,
    /// A value of the wrong type.
    #[error("{message}")]
    Value { message: String },
    #[error("more than {most} {what}: leave some out")]
    TooMany { what: &'static str, most: usize },
    #[error("is {}: must be {range}", short_number(*.found))]
    Range { found: f64, range: Cow<'static, str> },
}

/// What is wrong with a document.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem<P> {
    /// A problem that any document can have.
    #[error(transparent)]
    Common(CommonProblem),
    /// A problem that only this kind of document can have.
    #[error(transparent)]
    Own(P),
}

/// A document that was refused: a problem and its place.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{place}{}{problem}", .place.separator(.problem))]
pub struct DocumentError<P: std::error::Error + 'static> {
    /// Where.
    pub place: Place,
    /// What is wrong.
    pub problem: Problem<P>,
}

/// A problem with a key, before the file is known. The code that finds it sets the key, its callers add the table around the key
/// ([`Self::within`]), and the reader adds the text and the file ([`Self::in_text`], [`Self::in_file`]).
#[derive(Debug)]
pub struct KeyError<P> {
    /// The line, from 1, if it is known.
    pub line: Option<usize>,
    /// The path of the key, as in [`Place`].
    pub path: String,
    /// What is wrong.
    pub problem: Problem<P>,
}

impl<P> KeyError<P> {
    /// A problem with the whole document.
    pub const fn whole(line: Option<usize>, problem: P) -> Self {
        Self { line, path: String::new(), problem: Problem::Own(problem) }
    }

    /// A problem with one key.
    pub fn key(key: &str, problem: P) -> Self {
        Self { line: None, path: key.to_owned(), problem: Problem::Own(problem) }
    }

    /// A problem that any document can have.
    pub const fn common(line: Option<usize>, path: String, problem: CommonProblem) -> Self {
        Self { line, path, problem: Problem::Common(problem) }
    }

    /// Adds the line of the key in a TOML text, or the line of the nearest enclosing table that exists.
    pub fn in_text(self, text: &str) -> Self {
        let mut path = self.path.as_str();
        let mut line = self.line;
        while line.is_none() && !path.is_empty() {
            line = line_of(text, path);
            path = path.rfind(['.', '[']).map_or("", |end| &path[..end]);
        }
        Self { line, ..self }
    }

    /// Adds the table that the key belongs to.
    pub fn within(self, parent: &str) -> Self {
        let dot = if self.path.is_empty() { "" } else { "." };
        Self { path: format!("{parent}{dot}{}", self.path), ..self }
    }
}

impl<P: std::error::Error + 'static> KeyError<P> {
    /// Adds the file. Without a file it is a value made in memory, and has no line.
    pub fn in_file(self, file: Option<&str>) -> DocumentError<P> {
        let line = self.line.filter(|_| file.is_some());
        DocumentError {
            place: Place { file: file.map(str::to_owned), line, path: self.path },
            problem: self.problem,
        }
    }
}

/// Refuses a value that is not `good`.
///
/// # Errors
/// [`CommonProblem::Range`].
pub fn in_range<P>(
    key: &str,
    found: f64,
    good: bool,
    range: impl Into<Cow<'static, str>>,
) -> Result<(), KeyError<P>> {
    let range = || CommonProblem::Range { found, range: range.into() };
    if good { Ok(()) } else { Err(KeyError::common(None, key.to_owned(), range())) }
}
