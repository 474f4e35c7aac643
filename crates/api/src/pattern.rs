//! Patterns as the API lists and stores them.

use serde::{Deserialize, Serialize};

/// A line of a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PatternSummary {
    /// Its name.
    pub name: String,
    /// Whether it is part of the library.
    pub library: bool,
    /// How long one run lasts; null: endless.
    pub duration_s: Option<f64>,
    /// How many drives it has.
    pub drives: usize,
    /// SHA-256 of its file.
    pub sha256: String,
}

/// Everything there is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PatternList {
    /// Sorted by name.
    pub patterns: Vec<PatternSummary>,
    /// What could not be read, a line each.
    pub errors: Vec<String>,
}

/// The answer to `PUT /v1/patterns/NAME`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImportedPattern {
    /// Its name.
    pub name: String,
    /// SHA-256 of its bytes.
    pub sha256: String,
    /// What may not be what was meant.
    pub warnings: Vec<String>,
}
