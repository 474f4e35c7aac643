//! What to find in a file of samples, and what was found.

use super::error::SamplesError;
use serde::Deserialize;

/// A column of a table.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged, expecting = "must be a column's number, from 0, or its name")]
pub enum Column {
    /// Of an NPY file: its number, from 0.
    Number(u32),
    /// Of a CSV file: its name.
    Name(String),
}

/// What a reader found: values, not yet scaled.
pub(super) struct Found {
    pub(super) values: Vec<f64>,
    /// The file's own rate, if it has one.
    pub(super) rate_hz: Option<f64>,
    pub(super) note: String,
}

/// The column or channel to take of so many: the one that was asked for, or the only one.
pub(super) fn only(asked: Option<usize>, count: usize, what: &'static str) -> Result<usize, SamplesError> {
    match asked {
        Some(asked) if asked < count => Ok(asked),
        Some(asked) => Err(SamplesError::NoSuch { what, asked: asked.to_string(), count }),
        None if count == 1 => Ok(0),
        None => Err(SamplesError::Several { what, count }),
    }
}
