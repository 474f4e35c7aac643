//! How bodies are read, and the checks that several of them share.
//!
//! [`read`] turns a body into a request, or into one line that names the wrong key and offers the nearest known one. A check is given
//! the values of keys that several requests have: onset, scale, trigger, SHA-256, labels and names.

use crate::problem::{Code, Problem, REFERENCE};
use crate::trigger::TriggerRequest;
use meissner_input::document::{self, CommonProblem, KeyError, Table, Wanted};
use meissner_input::message::{is_plain, nearest, quote};
use serde::de::{DeserializeOwned, Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fmt;

/// `at_ms` at most, ms: an hour.
pub const MAX_AT_MS: f64 = 3_600_000.0;

/// Characters of a name, a label's key and a label's value, at most.
pub(crate) const MAX_NAME: usize = 100;
/// Labels of a session, and of a trial, at most.
pub(crate) const MAX_LABELS: usize = 16;

/// Free labels.
pub type Labels = BTreeMap<String, String>;

/// Reads a body; an empty one gives the defaults.
pub(crate) fn read_or_default<T: DeserializeOwned + Default>(body: &[u8]) -> Result<T, Problem> {
    if body.is_empty() { Ok(T::default()) } else { read(body) }
}

const WANTED: Wanted = |key| match key {
    "pattern" => "the name of a pattern",
    "participant" => "a pseudonym",
    _ => "it",
};

/// Reads a body.
pub(crate) fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T, Problem> {
    let text =
        std::str::from_utf8(body).map_err(|_| bad("the body is not UTF-8 text: send JSON in UTF-8"))?;
    document::from_json(text, WANTED).map(|Table(request)| request).map_err(problem)
}

/// The keys of an object, each there once.
#[derive(Debug)]
pub(crate) struct Keys(pub(crate) Map<String, Value>);

impl<'de> Deserialize<'de> for Keys {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        struct Once;
        impl<'de> Visitor<'de> for Once {
            type Value = Keys;

            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("a table of keys and values")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Keys, A::Error> {
                let mut keys = Map::new();
                while let Some((key, value)) = map.next_entry::<String, Value>()? {
                    if keys.contains_key(&key) {
                        return Err(A::Error::custom(format_args!("duplicate field `{key}`")));
                    }
                    keys.insert(key, value);
                }
                Ok(Keys(keys))
            }
        }
        source.deserialize_map(Once)
    }
}

/// Reads two structs whose keys stand in one object.
pub(crate) fn split<A: DeserializeOwned, B: DeserializeOwned>(
    Keys(keys): Keys,
    [first, second]: [&[&str]; 2],
) -> Result<(A, B), Problem> {
    let (mut own, mut others) = (Map::new(), Map::new());
    for (key, value) in keys {
        if first.contains(&&*key) {
            own.insert(key, value);
        } else if second.contains(&&*key) {
            others.insert(key, value);
        } else {
            let nearest = nearest(&[first, second].concat(), &key).to_owned();
            let unknown = CommonProblem::UnknownKey { key: quote(&key), nearest };
            return Err(problem(KeyError::common(None, String::new(), unknown)));
        }
    }
    Ok((of_keys(own)?, of_keys(others)?))
}

fn of_keys<T: DeserializeOwned>(keys: Map<String, Value>) -> Result<T, Problem> {
    document::from_source(Value::Object(keys), WANTED).map(|Table(read)| read).map_err(problem)
}

/// A fault of a body; one of the whole body gets a pointer to the API reference.
pub(crate) fn problem(fault: KeyError<Infallible>) -> Problem {
    let is_key = matches!(
        fault.problem,
        document::Problem::Common(CommonProblem::UnknownKey { .. } | CommonProblem::NoKeys { .. })
    );
    let is_whole = fault.path.is_empty() && !is_key;
    let refused = fault.in_file(None);
    bad(if is_whole {
        format!("the body is not a JSON object: {refused}; see {REFERENCE}")
    } else {
        refused.to_string()
    })
}

/// A fault of a request.
pub(crate) fn bad(detail: impl AsRef<str>) -> Problem {
    Problem::new(Code::BadRequest, detail)
}

/// Reads a key for which null means the default.
pub(crate) fn null_as_default<'de, D: Deserializer<'de>, T: Deserialize<'de> + Default>(
    source: D,
) -> Result<T, D::Error> {
    Option::deserialize(source).map(Option::unwrap_or_default)
}

/// Refuses more than one onset, and one out of range.
pub(crate) fn check_onset(
    tick: Option<u64>,
    ms: Option<f64>,
    monotonic_ns: Option<u64>,
    on_edge_ms: Option<f64>,
) -> Result<(), Problem> {
    let keys = [
        ("at_tick", tick.is_some()),
        ("at_ms", ms.is_some()),
        ("at_monotonic_ns", monotonic_ns.is_some()),
        ("on_edge_ms", on_edge_ms.is_some()),
    ];
    let mut given = keys.iter().filter(|(_, given)| *given).map(|(key, _)| key);
    if let (Some(first), Some(second)) = (given.next(), given.next()) {
        return Err(bad(format!("`{first}` and `{second}` exclude each other: leave one out")));
    }
    for (key, ms) in [("at_ms", ms), ("on_edge_ms", on_edge_ms)] {
        let Some(ms) = ms else { continue };
        let good = (0.0..=MAX_AT_MS).contains(&ms);
        document::in_range(key, ms, good, "0 to 3600000 ms, an hour").map_err(problem)?;
    }
    Ok(())
}

/// Whether this is a SHA-256 in hexadecimal.
pub fn is_sha256(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

/// Refuses what is no SHA-256.
pub(crate) fn check_sha256(sha256: Option<&str>) -> Result<(), &'static str> {
    let good = sha256.is_none_or(is_sha256);
    if good { Ok(()) } else { Err("`pattern_sha256` must be 64 of 0-9 and a-f") }
}

/// Refuses a scale out of range.
pub(crate) fn check_scale(scale: Option<f64>) -> Result<(), String> {
    let Some(scale) = scale else { return Ok(()) };
    let checked = document::in_range("scale", scale, (0.0..=1.0).contains(&scale), "0 to 1");
    checked.map_err(|error| problem(error).detail)
}

/// Refuses a trigger out of range.
pub(crate) fn check_trigger(trigger: Option<TriggerRequest>) -> Result<(), String> {
    match trigger {
        Some(TriggerRequest::On(shape)) => {
            shape.problem().map_or(Ok(()), |why| Err(format!("`trigger`: {why}")))
        }
        _ => Ok(()),
    }
}

/// Checks the labels of a session or trial.
pub(crate) fn check_labels(labels: &Labels) -> Result<(), Problem> {
    if labels.len() > MAX_LABELS {
        let detail = format!("`labels` has {} labels: at most {MAX_LABELS} are kept", labels.len());
        return Err(bad(detail));
    }
    labels.iter().try_for_each(|(key, value)| {
        check_text("labels", key)?;
        check_text("labels", value)
    })
}

/// Checks a name, or a part of a label.
pub(crate) fn check_text(key: &str, text: &str) -> Result<(), Problem> {
    if (1..=MAX_NAME).contains(&text.chars().count()) && text.chars().all(is_plain) {
        return Ok(());
    }
    let name = quote(text);
    Err(bad(format!(
        "`{key}` is {name}: must be 1 to {MAX_NAME} characters, without line breaks and the like"
    )))
}
