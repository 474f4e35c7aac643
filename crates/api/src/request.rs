//! Requests, read key by key.
//!
//! An error names the key; for an unknown key it offers the nearest known one.

use crate::problem::{Code, Problem};
use meissner_input::message::{nearest, quote};
use serde::de::{DeserializeOwned, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use std::fmt;

/// Bytes of a request's body at the most.
pub const MAX_BODY: usize = 1 << 20;

/// `POST /v1/play`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PlayRequest {
    /// Which pattern.
    pub pattern: String,
    /// Cuts it, or repeats it if it is finite.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// At this tick of the device's clock.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_tick: Option<u64>,
    /// So long after the order.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_ms: Option<f64>,
    /// The boot `at_tick` belongs to, as `device.boot` in the status; another one is refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub boot: Option<u32>,
    /// What to do when strokes come late.
    pub late: LatePolicy,
    /// Stop what runs and clear the queue first.
    pub replace: bool,
    /// No corrections from telemetry.
    pub open_loop: bool,
}

/// What to do when strokes come late.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LatePolicy {
    /// Drop them whole and go on.
    #[default]
    Drop,
    /// End the play: return the pins and disarm.
    Abort,
}

/// `at_ms` at the most: an hour.
pub const MAX_AT_MS: f64 = 3_600_000.0;

impl PlayRequest {
    const KEYS: [&str; 8] =
        ["pattern", "seconds", "at_tick", "at_ms", "boot", "late", "replace", "open_loop"];

    /// Reads a request's body.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let mut object = object(body, &Self::KEYS)?;
        let request = Self {
            pattern: key(&mut object, "pattern")?.ok_or_else(|| bad("`pattern` is missing: name one"))?,
            seconds: key(&mut object, "seconds")?,
            at_tick: key(&mut object, "at_tick")?,
            at_ms: key(&mut object, "at_ms")?,
            boot: key(&mut object, "boot")?,
            late: key(&mut object, "late")?.unwrap_or_default(),
            replace: key(&mut object, "replace")?.unwrap_or_default(),
            open_loop: key(&mut object, "open_loop")?.unwrap_or_default(),
        };
        match request.at_ms {
            Some(_) if request.at_tick.is_some() => {
                Err(bad("`at_tick` and `at_ms` exclude each other: leave one out"))
            }
            Some(ms) if !(0.0..=MAX_AT_MS).contains(&ms) => {
                Err(bad(format!("`at_ms` is {ms}: must be 0 to {MAX_AT_MS}")))
            }
            _ => Ok(request),
        }
    }
}

/// `POST /v1/arm`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ArmRequest {
    /// Take every pin as being at rest.
    pub assume_rest: bool,
}

impl ArmRequest {
    /// Reads a request's body; an empty one takes the defaults.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        if body.is_empty() {
            return Ok(Self::default());
        }
        let mut object = object(body, &["assume_rest"])?;
        Ok(Self { assume_rest: key(&mut object, "assume_rest")?.unwrap_or_default() })
    }
}

/// `POST /v1/calibrate`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CalibrateRequest {
    /// One motor; without it, all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motor: Option<u8>,
    /// The bursts' numbers of pulses; without it the default numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pulses: Option<Vec<u16>>,
    /// How often each is played; without it the default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repetitions: Option<u16>,
}

impl CalibrateRequest {
    /// Reads a request's body; an empty one takes the defaults.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        if body.is_empty() {
            return Ok(Self::default());
        }
        let mut object = object(body, &["motor", "pulses", "repetitions"])?;
        let (motor, pulses) = (key(&mut object, "motor")?, key(&mut object, "pulses")?);
        Ok(Self { motor, pulses, repetitions: key(&mut object, "repetitions")? })
    }
}

/// Reads the body of a request without arguments.
///
/// # Errors
/// A `bad-request` if there is something in it.
pub fn parse_empty(body: &[u8]) -> Result<(), Problem> {
    if body.is_empty() {
        return Ok(());
    }
    match object(body, &[])?.keys().next() {
        None => Ok(()),
        Some(unknown) => Err(bad(format!("unknown key {}: this command has none", quote(unknown)))),
    }
}

fn bad(detail: impl Into<String>) -> Problem {
    Problem::new(Code::BadRequest, detail)
}

/// An object, and a key that is in its text twice.
struct Keys {
    object: Map<String, Value>,
    twice: Option<String>,
}

impl<'de> Deserialize<'de> for Keys {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        struct Pairs;
        impl<'de> Visitor<'de> for Pairs {
            type Value = Keys;
            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut pairs: A) -> Result<Keys, A::Error> {
                let mut keys = Keys { object: Map::new(), twice: None };
                while let Some((key, value)) = pairs.next_entry::<String, Value>()? {
                    if keys.object.insert(key.clone(), value).is_some() {
                        keys.twice = Some(key);
                    }
                }
                Ok(keys)
            }
        }
        source.deserialize_map(Pairs)
    }
}

fn object(body: &[u8], known: &[&str]) -> Result<Map<String, Value>, Problem> {
    let Keys { object, twice } = serde_json::from_slice(body).map_err(|error| {
        bad(format!("the body is not a JSON object: {error}; see the API's documentation"))
    })?;
    if let Some(key) = twice {
        return Err(bad(format!("{} is there twice: leave one out", quote(&key))));
    }
    match object.keys().find(|key| !known.contains(&key.as_str())) {
        Some(unknown) if !known.is_empty() => {
            Err(bad(format!("unknown key {}: did you mean `{}`?", quote(unknown), nearest(known, unknown))))
        }
        _ => Ok(object),
    }
}

/// Takes a key; null is the same as absent.
fn key<T: DeserializeOwned>(object: &mut Map<String, Value>, key: &str) -> Result<Option<T>, Problem> {
    let value = object.remove(key).unwrap_or_default();
    serde_json::from_value(value).map_err(|error| bad(format!("`{key}`: {}", in_words(&error))))
}

/// What serde says, without the names of our types.
fn in_words(error: &serde_json::Error) -> String {
    let line = error.to_string().replace("expected f64", "expected a number");
    let line = line.replace("expected u32", &format!("expected a whole number from 0 to {}", u32::MAX));
    line.replace("expected u64", &format!("expected a whole number from 0 to {}", u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_play_request_is_read_key_by_key() {
        let read = |text: &str| PlayRequest::parse(text.as_bytes());
        let request = read(r#"{"pattern":"edge-45","seconds":2,"late":"abort","at_ms":null}"#).unwrap();
        assert_eq!(
            (request.pattern.as_str(), request.seconds, request.late),
            ("edge-45", Some(2.0), LatePolicy::Abort)
        );
        let json = serde_json::to_vec(&request).unwrap();
        assert_eq!(PlayRequest::parse(&json).unwrap(), request);
        for (text, says) in [
            (r#"{"pattern":"a","secnods":2}"#, "unknown key `secnods`: did you mean `seconds`?"),
            (r#"{"seconds":2}"#, "`pattern` is missing"),
            (r#"{"pattern":"a","seconds":"2"}"#, "`seconds`: invalid type: string \"2\", expected a number"),
            (r#"{"pattern":"a","boot":-1}"#, "expected a whole number from 0 to 4294967295"),
            (r#"{"pattern":"a","at_tick":1.5}"#, "expected a whole number from 0 to 18446744073709551615"),
            (r#"{"pattern":"a","seconds":1,"pattern":"b"}"#, "`pattern` is there twice: leave one out"),
            (r#"{"pattern":"a","late":"never"}"#, "`late`: unknown variant"),
            (r#"{"pattern":"a","at_ms":-1}"#, "`at_ms` is -1"),
            (r#"{"pattern":"a","at_ms":1,"at_tick":1}"#, "exclude"),
            ("[]", "not a JSON object"),
            ("", "not a JSON object"),
        ] {
            let problem = read(text).unwrap_err();
            assert!(problem.detail.contains(says), "{text}: {}", problem.detail);
            assert_eq!((problem.code.as_str(), problem.status), ("bad-request", 400));
            assert!(!problem.detail.contains('\n'));
        }
    }

    #[test]
    fn commands_without_arguments_take_none() {
        assert!(parse_empty(b"").is_ok() && parse_empty(b"{}").is_ok());
        assert!(parse_empty(br#"{"now":true}"#).unwrap_err().detail.contains("`now`"));
        assert!(ArmRequest::parse(b"").is_ok_and(|arm| !arm.assume_rest));
        assert!(ArmRequest::parse(br#"{"assume_rest":true}"#).unwrap().assume_rest);
        assert!(ArmRequest::parse(br#"{"assume_rset":true}"#).unwrap_err().detail.contains("`assume_rest`"));
    }
}
