//! Names in a file: those of models, and those of keys that also have a deprecated name. A file may have either name of a key, but
//! not both.

use meissner_input::document::KeyError;
use meissner_input::message::quote;
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// A model of the skin and its afferents.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ModelName {
    /// The first: RA afferents with a leaky membrane.
    #[default]
    Membrane,
    /// The second: skin mechanics, and SA1, RA and PC afferents.
    Afferents,
}

impl ModelName {
    /// The name on the command line and in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Membrane => "membrane",
            Self::Afferents => "afferents",
        }
    }
}

impl<'de> Deserialize<'de> for ModelName {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        struct Word;
        impl Visitor<'_> for Word {
            type Value = ModelName;
            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("\"membrane\" or \"afferents\"")
            }
            fn visit_str<E: Error>(self, found: &str) -> Result<ModelName, E> {
                match found {
                    "membrane" => Ok(ModelName::Membrane),
                    "afferents" => Ok(ModelName::Afferents),
                    _ => Err(E::custom(format_args!("is {}: must be membrane or afferents", quote(found)))),
                }
            }
        }
        source.deserialize_str(Word)
    }
}

/// Both names of a key are there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{name}` and `{deprecated}` are both there and mean the same: keep `{name}`")]
pub struct TwoNames {
    name: &'static str,
    deprecated: &'static str,
}

/// The value of a key under its name or its deprecated name, and the name that the file uses. Without a value that is the present
/// name.
///
/// # Errors
/// If both are there.
pub fn one_name<T>(
    (name, value): (&'static str, Option<T>),
    (deprecated, old): (&'static str, Option<T>),
) -> Result<(Option<T>, &'static str), TwoNames> {
    match (value, old) {
        (Some(_), Some(_)) => Err(TwoNames { name, deprecated }),
        (None, Some(value)) => Ok((Some(value), deprecated)),
        (value, None) => Ok((value, name)),
    }
}

/// Renames the key `name` in a fault about it, or about a part of it, to the name that the file uses.
#[must_use]
pub fn as_written<P>(fault: KeyError<P>, name: &str, written: &str) -> KeyError<P> {
    match fault.path.strip_prefix(name) {
        Some(rest) if rest.is_empty() || rest.starts_with(['.', '[']) => {
            KeyError { path: format!("{written}{rest}"), ..fault }
        }
        _ => fault,
    }
}
