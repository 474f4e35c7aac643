//! How an object file is read: its text, its numbers, and the files that it names.

use super::error::{KeyError, Problem};
use crate::touch::MAX_PLACE_MM;
use meissner_input::document::{CommonProblem, Table, Wanted, from_json, from_toml, in_range, line_of};
use meissner_input::message::cut;
use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer};
use std::io;

/// Gives the bytes of a file that an object names.
pub type Open<'o> = &'o mut dyn FnMut(&str) -> io::Result<Vec<u8>>;

/// Gives no files: for objects that are sent whole.
///
/// # Errors
/// Always: what to do instead.
pub fn no_files(_: &str) -> io::Result<Vec<u8>> {
    Err(io::Error::other("an object of a live play names no file, take another shape"))
}

pub(super) fn bytes_of(name: &str, open: Open<'_>) -> Result<Vec<u8>, KeyError> {
    open(name).map_err(|error| KeyError::key("file", Problem::File { message: cut(&error.to_string(), 200) }))
}

/// A text of keys, from which each part takes its own.
pub(super) enum Source<'t> {
    Toml(&'t str),
    Json(&'t str),
}

impl Source<'_> {
    pub(super) const fn text(&self) -> &str {
        let (Self::Toml(text) | Self::Json(text)) = self;
        text
    }

    pub(super) fn line_of(&self, key: &str) -> Option<usize> {
        if let Self::Toml(text) = self { line_of(text, key) } else { None }
    }

    /// Reads some of the keys.
    pub(super) fn read<T: DeserializeOwned>(&self, wanted: Wanted) -> Result<T, KeyError> {
        let read = match self {
            Self::Toml(text) => from_toml(text.strip_prefix('\u{feff}').unwrap_or(text), wanted),
            Self::Json(text) => from_json(text, wanted),
        };
        read.map(|Table(read)| read)
    }
}

/// Exactly so many numbers: serde's own arrays leave out what is too much.
#[derive(Clone, Deserialize)]
pub(super) struct Numbers<const N: usize>(#[serde(deserialize_with = "numbers")] pub(super) [f64; N]);

pub(super) fn numbers<'de, D: Deserializer<'de>, const N: usize>(source: D) -> Result<[f64; N], D::Error> {
    let all = Vec::<f64>::deserialize(source)?;
    let count = all.len();
    all.try_into().map_err(|_| D::Error::custom(format!("is a list of {count}: must be {N} numbers")))
}

pub(super) fn missing(key: &str, wanted: Wanted) -> KeyError {
    KeyError::common(None, key.to_owned(), CommonProblem::Missing { wanted: wanted(key) })
}

pub(super) fn check_places<'p>(
    key: &str,
    places: impl IntoIterator<Item = &'p [f64; 2]>,
) -> Result<(), KeyError> {
    for &place in places.into_iter().flatten() {
        in_range(key, place, place.abs() <= MAX_PLACE_MM, "-100 to 100 mm each")?;
    }
    Ok(())
}
