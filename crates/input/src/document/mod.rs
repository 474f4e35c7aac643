//! Reads TOML and JSON documents of known keys with serde.
//!
//! [`from_toml`] and [`from_json`] read a struct that is wrapped in [`Table`]. They turn the errors of serde into [`KeyError`]s: in
//! our words, with the path and the line, and with the nearest known key for an unknown one. The reader of each kind of document
//! decides which values are valid: it checks them with [`in_range`] and defines its own problems. A reader of untrusted texts calls
//! [`check_size`] first.
//!
//! Invariant: no error displays a line break.

mod error;
mod lines;
mod size;

pub use error::{CommonProblem, DocumentError, KeyError, Place, Problem, in_range};
pub use lines::line_of;
pub use size::{Size, check_size};

use crate::message::{foreign, nearest, one_line, quote};
use lines::line_at;
use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeOwned, Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, forward_to_deserialize_any};
use serde_path_to_error::{Path, Segment};
use std::fmt;
use std::marker::PhantomData;

/// Returns the text to add where the given key is missing.
pub type Wanted = fn(&str) -> &'static str;

/// Reads JSON, perhaps after a byte order mark, as Windows writes it. `wanted` names what to add where a key is missing.
///
/// # Errors
/// The first problem, with its key and line.
pub fn from_json<'t, T: Deserialize<'t>, P>(text: &'t str, wanted: Wanted) -> Result<Table<T>, KeyError<P>> {
    let mut source = serde_json::Deserializer::from_str(text.strip_prefix('\u{feff}').unwrap_or(text));
    let read = serde_path_to_error::deserialize(&mut source).map_err(|error| {
        let (path, error) = (error.path().clone(), error.into_inner());
        let out_of_range = error.to_string().starts_with("number out of range");
        if error.is_data() || out_of_range {
            data(&path, Some(error.line()), &without_place(&error), wanted)
        } else {
            json_syntax(&error)
        }
    })?;
    source.end().map_err(|error| json_syntax(&error))?;
    Ok(read)
}

fn json_syntax<P>(error: &serde_json::Error) -> KeyError<P> {
    let message = format!("{} (column {})", foreign(&without_place(error)), error.column());
    KeyError::common(Some(error.line()), String::new(), CommonProblem::Syntax { language: "JSON", message })
}

/// The message without serde's place: our errors add the place themselves.
fn without_place(error: &serde_json::Error) -> String {
    let mut message = error.to_string();
    let place = format!(" at line {} column {}", error.line(), error.column());
    message.truncate(message.strip_suffix(&place).map_or(message.len(), str::len));
    message
}

/// Reads TOML. `wanted` names what to add where a key is missing.
///
/// # Errors
/// The first problem, with its key and line.
pub fn from_toml<'t, T: Deserialize<'t>, P>(text: &'t str, wanted: Wanted) -> Result<Table<T>, KeyError<P>> {
    let line = |error: &toml::de::Error| Some(line_at(text, error.span()?.start));
    let source = toml::Deserializer::parse(text).map_err(|error| {
        let message = one_line(error.message());
        KeyError::common(line(&error), String::new(), CommonProblem::Syntax { language: "TOML", message })
    })?;
    serde_path_to_error::deserialize(source)
        .map_err(|error| data(error.path(), line(error.inner()), error.inner().message(), wanted))
}

/// Reads keys and values from another source, whose errors tell no place.
///
/// # Errors
/// The first problem, with its key.
pub fn from_source<'t, T: Deserialize<'t>, S: Deserializer<'t>, P>(
    source: S,
    wanted: Wanted,
) -> Result<Table<T>, KeyError<P>> {
    serde_path_to_error::deserialize(source)
        .map_err(|error| data(error.path(), None, &error.inner().to_string(), wanted))
}

/// An error of serde, in the words of [`CommonProblem`].
fn data<P>(path: &Path, line: Option<usize>, message: &str, wanted: Wanted) -> KeyError<P> {
    let mut keys: Vec<String> = path
        .iter()
        .map(|segment| match segment {
            Segment::Seq { index } => format!("[{index}]"),
            Segment::Map { key } => format!(".{key}"),
            Segment::Enum { .. } | Segment::Unknown => String::new(),
        })
        .collect();
    // The path may end with the wrong key or before it.
    let mut named = |key: &str, stays: bool| {
        keys.pop_if(|last| last.strip_prefix('.') == Some(key));
        if stays {
            keys.push(format!(".{key}"));
        }
    };
    let field = |kind: &str| message.strip_prefix(kind)?.strip_suffix('`');
    let problem = if let Some((key, known)) =
        message.strip_prefix("unknown field `").and_then(|rest| rest.rsplit_once("`, expected "))
    {
        named(key, false);
        let known: Vec<&str> = known.split('`').skip(1).step_by(2).collect();
        CommonProblem::UnknownKey { key: quote(key), nearest: nearest(&known, key).to_owned() }
    } else if let Some(key) =
        message.strip_prefix("unknown field `").and_then(|rest| rest.strip_suffix("`, there are no fields"))
    {
        named(key, false);
        CommonProblem::NoKeys { key: quote(key) }
    } else if let Some(key) = field("missing field `") {
        named(key, true);
        CommonProblem::Missing { wanted: wanted(key) }
    } else if let Some(key) = field("duplicate field `") {
        named(key, true);
        CommonProblem::Twice
    } else {
        CommonProblem::Value { message: in_words(message) }
    };
    let path = foreign(keys.concat().trim_start_matches('.'));
    KeyError::common(line.filter(|&line| line > 0), path, problem)
}

/// The message of serde about a value, without names of Rust types.
fn in_words(message: &str) -> String {
    let variant = message.strip_prefix("unknown variant `").and_then(|rest| rest.rsplit_once("`, expected "));
    if let Some((found, wanted)) = variant {
        return format!("unknown variant {}, expected {wanted}", quote(found));
    }
    let mistyped = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    let Some((found, wanted)) = mistyped.and_then(|rest| rest.rsplit_once(", expected ")) else {
        return foreign(message);
    };
    let wanted = match wanted {
        "f64" => "a number",
        "u64" => "a whole number, 0 or more",
        "u32" => "a whole number, 0 to 4294967295",
        "u16" => "a whole number, 0 to 65535",
        "u8" => "a whole number, 0 to 255",
        "a boolean" => "true or false",
        "i64" => "a whole number",
        "a map" => "a table of keys and values",
        "path string" => "a path in quotes",
        "a sequence" => "a list",
        other => other,
    };
    format!("is {}: must be {wanted}", foreign(found))
}

/// Reads the number, or the numbers, of a key that may be left out; null is refused. Many languages write NaN or an empty field as
/// null. If null counted as absent, it would mean the full amplitude, no end, or all motors.
///
/// # Errors
/// The value is null, or is not such a number.
pub fn given<'de, D: Deserializer<'de>, T: Deserialize<'de>>(source: D) -> Result<Option<T>, D::Error> {
    let null = || D::Error::custom("is null: must be a number; without a value leave the key out");
    Option::deserialize(source)?.map_or_else(|| Err(null()), |value| Ok(Some(value)))
}

/// The names of a struct's keys, as the reader that serde derives knows them.
pub fn keys_of<T: DeserializeOwned>() -> &'static [&'static str] {
    struct Names<'n>(&'n mut &'static [&'static str]);
    impl<'de> Deserializer<'de> for Names<'_> {
        type Error = serde::de::value::Error;
        fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Self::Error> {
            Err(Error::custom("names alone"))
        }
        fn deserialize_struct<V: Visitor<'de>>(
            self,
            _: &'static str,
            names: &'static [&'static str],
            visitor: V,
        ) -> Result<V::Value, Self::Error> {
            *self.0 = names;
            self.deserialize_any(visitor)
        }
        forward_to_deserialize_any! {
            bool i8 i16 i32 i64 u8 u16 u32 u64 f32 f64 char str string bytes byte_buf option unit unit_struct newtype_struct seq tuple
            tuple_struct map enum identifier ignored_any
        }
    }
    let mut names: &[&str] = &[];
    // The error is what it ends with.
    _ = T::deserialize(Names(&mut names));
    names
}

/// A struct that is written as a table of its keys. (The reader that serde derives also takes a list of its values.)
#[derive(Debug, Serialize)]
#[serde(transparent)]
pub struct Table<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Table<T> {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        struct Keys<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Keys<T> {
            type Value = Table<T>;
            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("a table of keys and values")
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Table<T>, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(Table)
            }
        }
        source.deserialize_map(Keys(PhantomData))
    }
}
