//! The pattern of a request: the name of a stored one, or the pattern itself.
//!
//! An inline pattern has the keys of a pattern file as JSON; `meissner-array` reads and checks them. Its samples may be packed in
//! base64, so its body may be large: [`check_packed`] bounds everything else before a reader allocates it.
//!
//! Invariant: a body that was checked has at most [`MAX_BODY`] bytes beside long strings.

use crate::problem::{Code, Problem};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use std::fmt;
use utoipa::openapi::schema::{AdditionalProperties, ObjectBuilder, OneOfBuilder, Schema, Type};

/// Size of the body of a request, at most, bytes.
pub const MAX_BODY: usize = 1 << 20;
/// Size of the body of a request that may hold packed samples, at most, bytes.
pub const MAX_PACKED_BODY: usize = 80 << 20;
/// A string of more bytes counts as packed samples.
const LONG: usize = 4096;

/// A pattern: its name, or itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum PatternChoice {
    /// The name of a stored pattern; `rendering:ID` for that of a rendering.
    Name(String),
    /// The pattern, with the keys of its file.
    Inline(Box<Map<String, Value>>),
}

impl<T: Into<String>> From<T> for PatternChoice {
    fn from(name: T) -> Self {
        Self::Name(name.into())
    }
}

impl PatternChoice {
    /// The name that the request gives it; of an inline pattern without a name `inline`.
    pub fn name(&self) -> &str {
        match self {
            Self::Name(name) => name,
            Self::Inline(keys) => keys.get("name").and_then(Value::as_str).unwrap_or(INLINE),
        }
    }

    /// The keys of an inline pattern.
    pub fn inline(&self) -> Option<&Map<String, Value>> {
        match self {
            Self::Name(_) => None,
            Self::Inline(keys) => Some(keys),
        }
    }
}

/// The name of an inline pattern that gives none.
pub const INLINE: &str = "inline";

impl<'de> Deserialize<'de> for PatternChoice {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        source.deserialize_any(Choice)
    }
}

/// Reads a pattern, or false or null for none.
pub(crate) fn or_blank<'de, D: Deserializer<'de>>(source: D) -> Result<Option<PatternChoice>, D::Error> {
    source.deserialize_any(OrBlank)
}

struct Choice;

impl<'de> Visitor<'de> for Choice {
    type Value = PatternChoice;

    fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
        text.write_str("the name of a pattern, or a pattern")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<PatternChoice, E> {
        Ok(name.into())
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<PatternChoice, A::Error> {
        let keys = Map::deserialize(MapAccessDeserializer::new(map))?;
        Ok(PatternChoice::Inline(Box::new(keys)))
    }
}

struct OrBlank;

impl<'de> Visitor<'de> for OrBlank {
    type Value = Option<PatternChoice>;

    fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
        text.write_str("the name of a pattern, a pattern, or false for a blank item")
    }

    fn visit_bool<E: Error>(self, plays: bool) -> Result<Self::Value, E> {
        if plays { Err(E::invalid_type(Unexpected::Bool(true), &self)) } else { Ok(None) }
    }

    fn visit_unit<E>(self) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Self::Value, E> {
        Choice.visit_str(name).map(Some)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        Choice.visit_map(map).map(Some)
    }
}

/// The schema of the key: a name, or an object.
pub(crate) fn schema() -> Schema {
    let name = ObjectBuilder::new().schema_type(Type::String);
    let inline = ObjectBuilder::new()
        .schema_type(Type::Object)
        .additional_properties(Some(AdditionalProperties::FreeForm(true)));
    let text = "The pattern's name, or `rendering:ID` for the pattern of a rendering; or the pattern itself: an object with the \
                keys of a [pattern file](pattern.md). `format` is then 2 and `name` is `inline` unless given. The play's hash is that \
                of its text as a file, which the session record keeps.";
    OneOfBuilder::new().item(name).item(inline).description(Some(text)).into()
}

/// [`schema`], or false, or null.
pub(crate) fn schema_or_blank() -> Schema {
    let no = ObjectBuilder::new().schema_type(Type::Boolean).enum_values(Some([false]));
    let null = ObjectBuilder::new().schema_type(Type::Null);
    let text = "The pattern's name, or the pattern itself as in `play`; false or null: nothing is played for `seconds`, for example in \
                a catch trial.";
    OneOfBuilder::new().item(schema()).item(no).item(null).description(Some(text)).into()
}

/// Refuses a body that is larger than [`MAX_BODY`] beside packed samples.
///
/// # Errors
/// `too-large`.
pub fn check_packed(body: &[u8]) -> Result<(), Problem> {
    if body.len() <= MAX_BODY {
        return Ok(());
    }
    let (mut others, mut rest) = (0, body);
    // Outside strings there is no quote; within one, a backslash hides the next byte.
    while let Some(begin) = rest.iter().position(|&byte| byte == b'"') {
        others += begin + 2;
        let text = &rest[begin + 1..];
        let (mut end, mut hidden) = (text.len(), false);
        for (at, &byte) in text.iter().enumerate() {
            if byte == b'"' && !hidden {
                end = at;
                break;
            }
            hidden = byte == b'\\' && !hidden;
        }
        if end <= LONG {
            others += end;
        }
        rest = text.get(end + 1..).unwrap_or_default();
        if others > MAX_BODY {
            break;
        }
    }
    if others + rest.len() <= MAX_BODY {
        return Ok(());
    }
    let detail = format!(
        "the body has more than {MAX_BODY} bytes beside packed samples: send less, or pack samples as `samples` (see \
         docs/reference/pattern.md)"
    );
    Err(Problem::new(Code::TooLarge, detail))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_packed_samples_may_be_long() {
        let packed = |samples: usize, rest: usize| {
            format!(
                r#"{{"pattern":{{"wave":[{{"samples":"{}"}}],"ramp":[{}]}}}}"#,
                "A".repeat(samples),
                "1,".repeat(rest / 2)
            )
        };
        let accepts = |text: &str| check_packed(text.as_bytes()).is_ok();
        assert!(accepts(&packed(8 << 20, 1000)) && accepts(&packed(10, (1 << 20) - 1000)));
        for text in
            [packed(8 << 20, 2 << 20), packed(10, 2 << 20), r#""a","#.repeat(1 << 19), "[".repeat(2 << 20)]
        {
            let problem = check_packed(text.as_bytes()).unwrap_err();
            assert_eq!((problem.code.as_str(), problem.detail.lines().count()), ("too-large", 1));
        }
        // A quote within a string does not end it.
        assert!(accepts(&format!(r#"{{"a":"{}\"{}"}}"#, "x".repeat(1 << 20), "y".repeat(1 << 20))));
        assert!(!accepts(&format!(r#""{}""#, r#"\\""#.repeat(1 << 19))));
    }

    #[test]
    fn a_pattern_is_a_name_or_an_object() {
        let read = |text: &str| serde_json::from_str::<PatternChoice>(text);
        assert_eq!(read("\"edge-45\"").unwrap(), "edge-45".into());
        let inline = read(r#"{"ramp": [{"motor": 9}]}"#).unwrap();
        assert_eq!((inline.name(), inline.inline().is_some()), ("inline", true));
        assert_eq!(serde_json::to_string(&inline).unwrap(), r#"{"ramp":[{"motor":9}]}"#);
        for text in ["null", "5", "[]"] {
            let line = read(text).unwrap_err().to_string();
            assert!(line.contains("the name of a pattern, or a pattern"), "{line}");
        }
    }
}
