//! Problems of a configuration, and the check of one number.
//!
//! Invariant: a message is one line that names the key, what was found, and what is allowed.

use meissner_input::document::{self, DocumentError, in_range};
use meissner_stream::device::SpecError;
use std::io;
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// A configuration that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: {source}; name a readable file with --config", .file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Its text is refused.
    #[error(transparent)]
    Refused(#[from] DocumentError<Problem>),
}

/// A problem of one key, besides those that all documents share.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("is {found}: {source}")]
    Device { found: String, source: SpecError },
    #[error("is empty: name one, or leave the key out")]
    EmptyPath,
    #[error("holds a control character: name a path without one")]
    ControlCharacter,
    #[error("is {found}: must be an address and a port, as \"127.0.0.1:8765\", or \"none\"")]
    Listen { found: String },
    #[error("is {found}: emergency stops take the port after it: choose 65534 at most")]
    LastPort { found: String },
    #[error("is {found}: must be a host's name, without port and path")]
    Host { found: String },
    #[error(
        "is {found}: must be a site, as \"https://lab.example\" or \"http://localhost:3000\", in lower case, without path"
    )]
    Origin { found: String },
    #[error("is {found}: must be \"remote\" or \"always\"")]
    ListenToken { found: String },
    #[error("is {found}: {error}")]
    Array { found: String, error: String },
    #[error("is {found}: must be a number of um, or \"auto\"")]
    Surplus { found: String },
    #[error(
        "is at_rest: a seek of the stop takes {seek} pulses, and a motor of this array may push for {most} in a second; lower most_pulses in its description"
    )]
    LowerStop { seek: u16, most: u32 },
}

pub(super) type KeyError = document::KeyError<Problem>;

/// The value of a key, or its default; refuses one out of range.
pub(super) fn checked(
    key: &str,
    found: Option<f64>,
    default: f64,
    range: RangeInclusive<f64>,
    unit: &str,
) -> Result<f64, KeyError> {
    let found = found.unwrap_or(default);
    let text = format!("{} to {} {unit}", range.start(), range.end());
    in_range(key, found, range.contains(&found), text).map(|()| found)
}
