//! Sequences: many patterns with exact times in one request, and the record of each in the receipt.
//!
//! [`SequenceRequest::parse`] reads a body; it is larger than the bodies of other commands, so the daemon reads it on a separate
//! thread.
//!
//! Bound: [`MAX_SEQUENCE_ITEMS`]; the reader stops there.

use crate::body::{
    bad, check_labels, check_onset, check_scale, check_sha256, check_trigger, null_as_default, read,
};
use crate::pattern_choice::{self, PatternChoice, check_packed};
use crate::problem::Problem;
use crate::request::{LatePolicy, check_hold, check_text_of};
use crate::trigger::{self, TriggerRecord, TriggerRequest};
use meissner_input::document::{self, given};
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fmt;
use std::sync::Arc;
use utoipa::ToSchema;

/// Items of a sequence, at most.
pub const MAX_SEQUENCE_ITEMS: usize = 4096;

/// Patterns to play with exact times, as one play: one after the other, or at the same time on other motors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({
    "name": "block-1", "at_ms": 500.0,
    "items": [
        {"pattern": "edge-45", "seconds": 0.5, "trigger": {"code": 1}},
        {"pattern": "edge-45", "seconds": 0.5, "scale": 0.5, "gap_ms": 1200.0, "trigger": {"code": 2}},
        {"pattern": "pin-60", "seconds": 0.25, "start_ms": 4000.0, "trigger": false}
    ]
})))]
pub struct SequenceRequest {
    /// The items, in order of their beginnings.
    #[serde(deserialize_with = "bounded")]
    #[schema(max_items = 4096)]
    pub items: Vec<SequenceItem>,
    /// What status, events and receipt call the sequence, as a pattern's name; without it `sequence`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Onset on the device's clock, ticks. Excludes `at_ms` and `at_monotonic_ns`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub at_tick: Option<u64>,
    /// Delay from the request to the onset, ms. Excludes `at_tick` and `at_monotonic_ns`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 3_600_000.0)]
    pub at_ms: Option<f64>,
    /// Onset on the host's `CLOCK_MONOTONIC`, ns. Excludes `at_tick` and `at_ms`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub at_monotonic_ns: Option<u64>,
    /// Delay from an edge of the trigger input to the onset, ms, to the nearest tick: the first edge after the daemon has taken the sequence and
    /// those before it are over. The daemon names the least delay, about 5 ms. Excludes `at_tick`, `at_ms` and `at_monotonic_ns`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 3_600_000.0)]
    pub on_edge_ms: Option<f64>,
    /// Whether the first edge of the trigger input after the onset stops the sequence and clears the queue, as `POST /v1/stop` does.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "std::ops::Not::not")]
    pub stop_on_edge: bool,
    /// The boot that `at_tick` belongs to, as `device.boot` in the status. The daemon refuses another one.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub boot: Option<u32>,
    /// What to do when strokes come late: `drop` them (the default) or `abort` the sequence.
    #[serde(default, deserialize_with = "null_as_default")]
    pub late: LatePolicy,
    /// Whether to stop the running play and clear the queue first.
    #[serde(default, deserialize_with = "null_as_default")]
    pub replace: bool,
    /// Whether to play without corrections from telemetry.
    #[serde(default, deserialize_with = "null_as_default")]
    pub open_loop: bool,
    /// The session that the sequence belongs to. Without it the running one, if any; the daemon refuses another one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// The trial's number.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub trial: Option<u64>,
    /// Up to 16 labels of the trial, of 1 to 100 characters.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, String>,
    /// Whether to refuse motions that a motor is too slow for.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "std::ops::Not::not")]
    pub strict: bool,
    /// How long a pin may stay above rest without a pulse, ms, in any item: then the device lowers it by itself. Without it as long as the
    /// sequence needs. Less than that is refused.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1.0, maximum = 60_000.0)]
    pub hold_ms: Option<f64>,
}

/// A pattern in a sequence. Times are summed in whole nanoseconds from the sequence's onset, and each sum becomes the nearest tick
/// once, so that no rounding adds up.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SequenceItem {
    /// The pattern's name, or the pattern itself; false or null: nothing is played for `seconds`, for example in a catch trial.
    #[schema(required, schema_with = pattern_choice::schema_or_blank)]
    #[serde(deserialize_with = "pattern_choice::or_blank")]
    pub pattern: Option<PatternChoice>,
    /// Play the text with this SHA-256 (hexadecimal): the stored pattern, or else the text that the session record keeps. Without
    /// either the daemon refuses. Without the key: the stored pattern.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 64, max_length = 64)]
    pub pattern_sha256: Option<String>,
    /// Duration, s: truncates the pattern, or repeats it if it is finite. A pattern without end needs it.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub seconds: Option<f64>,
    /// Multiplies the amplitude of every drive; without it 1.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub scale: Option<f64>,
    /// Pause from the end of all items before it, or from the sequence's onset, ms; without it 0. Excludes `start_ms`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1e11)]
    pub gap_ms: Option<f64>,
    /// Time from the sequence's onset to the item's, ms. Excludes `gap_ms`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1e11)]
    pub start_ms: Option<f64>,
    /// What the trigger output gives at the item's onset; without it one pulse of 10 ms, or of half the time to the next onset if that
    /// is shorter.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = trigger::schema)]
    pub trigger: Option<TriggerRequest>,
}

impl SequenceRequest {
    /// Reads a body.
    ///
    /// # Errors
    /// A `bad-request` that names the item and the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        check_packed(body)?;
        read::<Self>(body)?.checked()
    }

    /// Reads a file: TOML with a table `[[items]]` for each item, or JSON as in a body.
    ///
    /// # Errors
    /// A `bad-request` that names the item and the key.
    pub fn parse_file(text: &str) -> Result<Self, Problem> {
        if text.trim_start().starts_with('{') {
            return Self::parse(text.as_bytes());
        }
        let wanted = |key: &str| if key == "pattern" { "the name of a pattern, or false" } else { "it" };
        let read = document::from_toml(text, wanted).map(|document::Table(request)| request);
        read.map_err(|fault: document::KeyError<Infallible>| bad(fault.in_file(None).to_string()))
            .and_then(Self::checked)
    }

    fn checked(self) -> Result<Self, Problem> {
        let request = self;
        check_onset(request.at_tick, request.at_ms, request.at_monotonic_ns, request.on_edge_ms)?;
        check_labels(&request.labels)?;
        check_hold(request.hold_ms)?;
        if request.items.is_empty() {
            return Err(bad("`items` is empty: add an item"));
        }
        if let Some(name) = &request.name {
            let letter = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-';
            if !((1..=64).contains(&name.len()) && name.bytes().all(letter)) {
                return Err(bad("`name` must be 1 to 64 of a-z, 0-9 and -"));
            }
        }
        for (number, item) in request.items.iter().enumerate() {
            item.check().map_err(|detail| bad(format!("`items[{number}]`: {detail}")))?;
        }
        Ok(request)
    }
}

impl SequenceItem {
    fn check(&self) -> Result<(), String> {
        if self.gap_ms.is_some() && self.start_ms.is_some() {
            return Err("`gap_ms` and `start_ms` exclude each other: leave one out".to_owned());
        }
        check_sha256(self.pattern_sha256.as_deref()).map_err(str::to_owned)?;
        match &self.pattern {
            Some(pattern) => check_text_of(pattern, self.pattern_sha256.as_deref())?,
            None if self.seconds.is_none() => return Err("a blank item needs `seconds`".to_owned()),
            None if self.pattern_sha256.is_some() || self.scale.is_some() => {
                return Err(
                    "a blank item has neither `pattern_sha256` nor `scale`: leave them out".to_owned()
                );
            }
            None => {}
        }
        check_scale(self.scale)?;
        check_trigger(self.trigger)
    }
}

/// Reads a list up to its bound.
fn bounded<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<SequenceItem>, D::Error> {
    struct Items;
    impl<'de> Visitor<'de> for Items {
        type Value = Vec<SequenceItem>;

        fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
            text.write_str("a list of items")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
            let mut items = Vec::new();
            while let Some(item) = list.next_element()? {
                if items.len() == MAX_SEQUENCE_ITEMS {
                    return Err(A::Error::custom(format_args!(
                        "more than {MAX_SEQUENCE_ITEMS} items: divide it"
                    )));
                }
                items.push(item);
            }
            Ok(items)
        }
    }
    from.deserialize_seq(Items)
}

/// What became of an item: `played` (every stroke), `incomplete` (strokes came late or were refused), `cut` (the sequence ended
/// within it) or `not-begun`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ItemState {
    /// Every stroke was played.
    Played,
    /// Strokes came late or were refused.
    Incomplete,
    /// The sequence ended within the item.
    Cut,
    /// The sequence ended before the item's onset.
    NotBegun,
}

impl ItemState {
    /// The state's name in the JSON.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Played => "played",
            Self::Incomplete => "incomplete",
            Self::Cut => "cut",
            Self::NotBegun => "not-begun",
        }
    }
}

/// A device tick, and when it came on the host's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct InstantRecord {
    /// The tick of the device's clock.
    pub tick: u64,
    /// The same instant on the host's `CLOCK_MONOTONIC`, ns.
    pub monotonic_ns: u64,
    /// Uncertainty of `monotonic_ns`, ns.
    pub uncertainty_ns: u64,
}

/// What became of an item of a sequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ItemRecord {
    /// The pattern's name; `blank` for an item in which nothing was played.
    #[schema(value_type = String)]
    pub pattern: Arc<str>,
    /// SHA-256 of the pattern's file, in hexadecimal; empty for a blank item.
    #[schema(value_type = String)]
    pub pattern_sha256: Arc<str>,
    /// The factor of the amplitudes.
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub scale: f64,
    /// The largest amplitude of its drives or level of its motions as ordered, µm.
    pub ordered_um: f64,
    /// The largest amplitude that they reach in whole pulses, µm.
    pub reached_um: f64,
    /// When it was to begin, ticks from the sequence's onset.
    pub planned_onset_ticks: u64,
    /// How long it was to last, ms: a whole number of ticks.
    pub ordered_ms: f64,
    /// What became of it.
    pub state: ItemState,
    /// The item's onset, as the device reported it; null if it has not begun, or if the device learned of it too late.
    pub onset: Option<InstantRecord>,
    /// Start of its first pulse, ticks; later than the onset if no drive begins with a stroke or the
    /// first strokes were late or refused. Null if the device accepted none.
    pub first_pulse_tick: Option<u64>,
    /// The end of the last stroke that the device accepted, as planned; corrections by feedback may shift it by some ticks. Null if it
    /// accepted none, or was cut before, or if the link was lost before it reported so far.
    pub offset: Option<InstantRecord>,
    /// What the trigger output gave at the onset; null: nothing.
    pub trigger: Option<TriggerRecord>,
    /// Number of its strokes that came late.
    pub late_strokes: u32,
    /// Number of its strokes that the device refused.
    pub refused_strokes: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_item_and_the_key() {
        let read = |text: &str| SequenceRequest::parse(text.as_bytes());
        let text = r#"{"items":[{"pattern":"a"},{"pattern":"b","seconds":1,"scale":0.5,"gap_ms":2.5,"trigger":{"code":3}},
            {"pattern":"a","start_ms":1e3,"trigger":false}],"name":"block-1","at_tick":5}"#;
        let request = read(text).unwrap();
        assert_eq!((request.items.len(), request.items[1].gap_ms), (3, Some(2.5)));
        assert_eq!(read(&serde_json::to_string(&request).unwrap()).unwrap(), request);
        for (text, says) in [
            (r#"{"items":[{"pattern":"a"},{"seconds":1}]}"#, "`items[1].pattern` is missing"),
            (r#"{"items":[{"pattern":"a","gap":1}]}"#, "unknown key `gap`: did you mean `gap_ms`?"),
            (r#"{"items":[]}"#, "`items` is empty"),
            (
                r#"{"items":[{"pattern":"a","gap_ms":1,"start_ms":1}]}"#,
                "`items[0]`: `gap_ms` and `start_ms` exclude",
            ),
            (r#"{"items":[{"pattern":"a","scale":1.5}]}"#, "`items[0]`: `scale` is 1.5: must be 0 to 1"),
            (
                r#"{"items":[{"pattern":"a","trigger":{"width_ms":0}}]}"#,
                "`items[0]`: `trigger`: `width_ms` must be",
            ),
            (r#"{"items":[{"pattern":"a"}],"at_ms":1,"at_tick":1}"#, "exclude each other"),
            (r#"{"items":[{"pattern":"a"}],"name":"A b"}"#, "`name` must be"),
            (r#"{"items":[{"pattern":"a"}],"hold_ms":0}"#, "`hold_ms` is 0: must be 1 to 60000 ms"),
            (r#"{"items":[{"pattern":true,"seconds":1}]}"#, "`items[0].pattern` is boolean `true`"),
            (r#"{"items":7}"#, "`items` is integer `7`: must be a list of items"),
        ] {
            let problem = read(text).unwrap_err();
            assert!(problem.detail.contains(says), "{text}: {}", problem.detail);
            assert_eq!(problem.code, "bad-request");
        }
        let file = "name = \"block-1\"\nat_tick = 5\n[[items]]\npattern = \"a\"\n[[items]]\npattern = \"b\"\nseconds = 1.0\n\
                    scale = 0.5\ngap_ms = 2.5\ntrigger.code = 3\n[[items]]\npattern = \"a\"\nstart_ms = 1e3\ntrigger = false\n";
        assert_eq!(SequenceRequest::parse_file(file).unwrap(), request);
        assert_eq!(SequenceRequest::parse_file(text).unwrap(), request);
        // TOML has no null.
        let blank = "strict = true\nhold_ms = 500\n[[items]]\npattern = false\nseconds = 0.5\n";
        let blank = SequenceRequest::parse_file(blank).unwrap();
        assert_eq!((blank.items[0].pattern.as_ref(), blank.strict, blank.hold_ms), (None, true, Some(500.0)));
        assert_eq!(read(&serde_json::to_string(&blank).unwrap()).unwrap(), blank);
        let wrong = SequenceRequest::parse_file("[[items]]\npatern = \"a\"\n").unwrap_err();
        assert!(wrong.detail.contains("did you mean `pattern`?"), "{wrong}");
        let many = |count| format!("{{\"items\":[{}]}}", vec![r#"{"pattern":"a"}"#; count].join(","));
        assert!(read(&many(MAX_SEQUENCE_ITEMS)).is_ok());
        assert!(read(&many(MAX_SEQUENCE_ITEMS + 1)).unwrap_err().detail.contains("more than 4096 items"));
    }
}
