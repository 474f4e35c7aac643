//! The trigger output: the pulse that a play or an item requests, and the pulse that the device gave.
//!
//! In a request `trigger` is an object or `false`; without it the output gives one pulse of 10 ms. `docs/board.md` shows the
//! pulse train of a code.

use meissner_input::document::given;
use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use utoipa::ToSchema;
use utoipa::openapi::schema::{ObjectBuilder, Schema, SchemaType, Type};

/// Width of a pulse without `width_ms`, ms: long enough for an amplifier that samples at 200 Hz.
pub const PULSE_MS: f64 = 10.0;
/// Width of a code's cell without `width_ms`, ms: two samples of an amplifier at 1 kHz fit into it twice.
pub const CELL_MS: f64 = 4.0;
/// The smallest and the largest `width_ms`.
pub const WIDTH_MS: std::ops::RangeInclusive<f64> = 0.1..=500.0;

/// What the trigger output gives at an onset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TriggerRequest {
    /// Nothing.
    Off,
    /// A pulse or a code.
    On(TriggerShape),
}

/// A pulse, or a code as a pulse train.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TriggerShape {
    /// Width of the pulse, or of each of the ten cells of a code, ms.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub width_ms: Option<f64>,
    /// A code, 1 to 255; without it one pulse.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub code: Option<u8>,
}

impl TriggerShape {
    /// The width in use, ms.
    pub fn width_ms(&self) -> f64 {
        self.width_ms.unwrap_or(if self.code.is_some() { CELL_MS } else { PULSE_MS })
    }

    /// Why it cannot be given.
    pub(crate) fn problem(&self) -> Option<&'static str> {
        if self.width_ms.is_some_and(|ms| !WIDTH_MS.contains(&ms)) {
            return Some("`width_ms` must be 0.1 to 500 ms");
        }
        (self.code == Some(0)).then_some("`code` must be 1 to 255; leave it out for one pulse")
    }
}

impl Serialize for TriggerRequest {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Off => to.serialize_bool(false),
            Self::On(shape) => shape.serialize(to),
        }
    }
}

impl<'de> Deserialize<'de> for TriggerRequest {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Choice;
        impl<'de> Visitor<'de> for Choice {
            type Value = TriggerRequest;

            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("false, or a table with `width_ms` and `code`")
            }

            fn visit_bool<E>(self, on: bool) -> Result<TriggerRequest, E> {
                Ok(if on { TriggerRequest::On(TriggerShape::default()) } else { TriggerRequest::Off })
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<TriggerRequest, A::Error> {
                TriggerShape::deserialize(MapAccessDeserializer::new(map)).map(TriggerRequest::On)
            }
        }
        from.deserialize_any(Choice)
    }
}

/// The schema of `trigger` in a request.
pub(crate) fn schema() -> Schema {
    let number = |text, least, most| {
        ObjectBuilder::new().description(Some(text)).minimum(Some(least)).maximum(Some(most))
    };
    let width = number(
        "Width of the pulse, or of each of the ten cells of a code, ms; without it 10, with a code 4.",
        *WIDTH_MS.start(),
        *WIDTH_MS.end(),
    );
    let code = number("A code instead of one pulse.", 1.0, 255.0);
    let text = "What the trigger output gives at the onset: an object with `width_ms` and `code`, or `false` for nothing. Without it \
                one pulse of 10 ms.";
    ObjectBuilder::new()
        .schema_type(SchemaType::from_iter([Type::Object, Type::Boolean]))
        .property("width_ms", width.schema_type(Type::Number))
        .property("code", code.schema_type(Type::Integer))
        .description(Some(text))
        .into()
}

/// What the trigger output gave, as the device reported it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TriggerRecord {
    /// The tick at which the output rose, ticks.
    pub tick: u64,
    /// Width of the pulse, or of each of the ten cells of a code, ms.
    pub width_ms: f64,
    /// The code; null: one pulse.
    #[schema(minimum = 1, maximum = 255)]
    pub code: Option<u8>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trigger_is_false_or_a_table() {
        let read = |text: &str| serde_json::from_str::<TriggerRequest>(text);
        let on = |width_ms, code| TriggerRequest::On(TriggerShape { width_ms, code });
        assert_eq!(read("false").unwrap(), TriggerRequest::Off);
        assert_eq!(read("{}").unwrap(), on(None, None));
        assert_eq!(read("true").unwrap(), on(None, None));
        let coded = read(r#"{"width_ms": 2, "code": 65}"#).unwrap();
        assert_eq!(coded, on(Some(2.0), Some(65)));
        assert_eq!(read(&serde_json::to_string(&coded).unwrap()).unwrap(), coded);
        for bad in ["1", r#"{"code": 256}"#, r#"{"widht_ms": 2}"#, "[]"] {
            assert!(read(bad).is_err(), "{bad}");
        }
        let shape = |width_ms, code| TriggerShape { width_ms, code };
        assert_eq!((shape(None, None).width_ms(), shape(None, Some(1)).width_ms()), (10.0, 4.0));
        assert!(shape(Some(0.0), None).problem().is_some() && shape(None, Some(0)).problem().is_some());
        assert_eq!(shape(Some(500.0), Some(255)).problem(), None);
    }
}
