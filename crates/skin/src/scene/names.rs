//! The names of models in a file.

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
