//! What can be wrong with a scene, said in one line: what, where, what to do.
//!
//! A check knows the key, its callers where that stands (`drives[3].frequency_hz`), the reader the file. Text taken
//! from a file is quoted and cut, so that it cannot break the line.
//!
//! Invariant: the display of a [`SceneError`] holds no line break.

use crate::motor::MotorError;
use std::fmt;

/// A scene that was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{place}{}{problem}", joint(.place, .problem))]
pub struct SceneError {
    /// Where it is wrong.
    pub place: Place,
    /// What is wrong.
    pub problem: Problem,
}

/// A place in a scene.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// The file as the caller named it, if there is one.
    pub file: Option<String>,
    /// The line, from 1, if it is known.
    pub line: Option<usize>,
    /// The way to the key as `drives[3].frequency_hz`, counted from 0; empty if it is about the whole.
    pub path: String,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let joint = if self.file.is_some() && !self.path.is_empty() { ": " } else { "" };
        if let Some(file) = &self.file {
            write!(f, "{}", file.escape_debug())?;
        }
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if self.path.is_empty() { Ok(()) } else { write!(f, "{joint}`{}`", self.path) }
    }
}

/// A problem with a value reads on from its key.
fn joint(place: &Place, problem: &Problem) -> &'static str {
    match problem {
        _ if *place == Place::default() => "",
        _ if !place.path.is_empty() && problem.to_string().starts_with("is ") => " ",
        _ => ": ",
    }
}

/// What is wrong, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a scene in {language} has at most {most}{advice}")]
    TooLarge { bytes: usize, language: &'static str, most: usize, advice: &'static str },
    #[error("not {language}: {message}")]
    Syntax { language: &'static str, message: String },
    #[error("unknown key {key}: did you mean `{nearest}`?")]
    UnknownKey { key: String, nearest: String },
    #[error("is missing: add {wanted}")]
    Missing { wanted: &'static str },
    #[error("is there twice: leave one out")]
    Twice,
    /// A value that cannot be read as what the key wants.
    #[error("{message}")]
    Value { message: String },
    #[error("neither `receptors` nor `population` is there: add one of them")]
    NoReceptors,
    #[error("`receptors` and `population` are both there: leave one out")]
    TwoPopulations,
    #[error("is {}: must be {range}", figure(*.found))]
    Range { found: f64, range: &'static str },
    #[error("{0}")]
    Wave(#[source] MotorError),
    #[error("is {}: must be above start_s, which is {}", figure(*.stop_s), figure(*.start_s))]
    StopsBeforeStart { start_s: f64, stop_s: f64 },
    #[error(
        "motor {motor} is still driven by drives[{other}]: stop that by {start_s} s, or start this one later"
    )]
    Overlap { motor: u8, other: usize, start_s: f64 },
}

/// A number, short also if it is very large or very small.
pub(super) fn figure(number: f64) -> String {
    let plain = number == 0.0 || !number.is_finite() || (1e-6..1e16).contains(&number.abs());
    if plain { number.to_string() } else { format!("{number:e}") }
}

/// A problem on its way to its place.
#[derive(Debug)]
pub(super) struct Fault {
    pub(super) line: Option<usize>,
    pub(super) path: String,
    pub(super) problem: Problem,
}

impl Fault {
    pub(super) const fn whole(line: Option<usize>, problem: Problem) -> Self {
        Self { line, path: String::new(), problem }
    }

    pub(super) fn key(key: &str, problem: Problem) -> Self {
        Self { line: None, path: key.to_owned(), problem }
    }

    pub(super) fn within(self, parent: &str) -> Self {
        Self { path: format!("{parent}.{}", self.path), ..self }
    }

    pub(super) fn at(self, file: &str) -> SceneError {
        let place = Place { file: Some(file.to_owned()), line: self.line, path: self.path };
        SceneError { place, problem: self.problem }
    }

    pub(super) fn built(self) -> SceneError {
        let place = Place { path: self.path, ..Place::default() };
        SceneError { place, problem: self.problem }
    }
}
