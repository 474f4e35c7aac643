//! An order: what to play, when, and how. One pattern, or many with exact times as one play.
//!
//! [`Order::parse`] reads a body, [`Order::parse_file`] a file. Its [`Terms`] hold for the whole play. An order of one item may be written
//! flat: the keys of the item beside those of the terms.
//!
//! Bound: [`MAX_ITEMS`].

use crate::body::{
    Keys, bad, check_labels, check_onset, check_scale, check_sha256, check_trigger, null_as_default, problem,
    read, split,
};
use crate::pattern_choice::{self, PatternChoice, check_packed};
use crate::problem::Problem;
use crate::trigger::{self, TriggerRequest};
use meissner_input::document::{self, given, keys_of};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::ops::RangeInclusive;
use utoipa::ToSchema;

/// Items of an order, at most.
pub const MAX_ITEMS: usize = 4096;
/// The range of `hold_ms`, ms: what the device allows at most.
pub const HOLD_MS: RangeInclusive<f64> = 1.0..=60_000.0;
/// `seconds` at most, s.
const MAX_SECONDS: f64 = 1e8;
/// How long `GET /v1/plays/{id}` may wait for the end of the play, s.
pub const MAX_WAIT_S: f64 = 60.0;

/// What to play, when, and how: one pattern, or `items` one after the other or at the same time on other motors, as one play.
#[derive(Clone, Debug, Default, PartialEq, ToSchema)]
#[schema(examples(
    json!({"pattern": "edge-45", "seconds": 2.0, "at_ms": 500.0, "late": "abort"}),
    json!({
        "name": "block-1", "at_ms": 500.0,
        "items": [
            {"pattern": "edge-45", "seconds": 0.5, "trigger": {"code": 1}},
            {"pattern": "edge-45", "seconds": 0.5, "scale": 0.5, "gap_ms": 1200.0, "trigger": {"code": 2}},
            {"pattern": "pin-60", "seconds": 0.25, "start_ms": 4000.0, "trigger": false}
        ]
    })
))]
pub struct Order {
    /// What status, events and receipt call the play, and then the receipt lists its items. Without a name one pattern gives it its own,
    /// and several items are called `sequence`.
    pub name: Option<String>,
    /// The items, in order of their beginnings, in place of the keys of one item.
    #[schema(max_items = 4096)]
    pub items: Vec<Item>,
    /// When, and how.
    #[schema(ignore)]
    pub terms: Terms,
}

/// A pattern in an order. Times are summed in whole nanoseconds from the play's onset, and each sum becomes the nearest tick
/// once, so that no rounding adds up.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Item {
    /// The pattern's name; `rendering:ID` for the pattern of a rendering; or the pattern itself; false or null: nothing is played for `seconds`, for
    /// example in a catch trial.
    #[schema(required, schema_with = pattern_choice::schema_or_blank)]
    #[serde(deserialize_with = "pattern_choice::or_blank")]
    pub pattern: Option<PatternChoice>,
    /// Play the text with this SHA-256 (hexadecimal): the stored pattern, or else the text that the session record keeps. Without
    /// either the daemon refuses. Without the key: the stored pattern.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 64, max_length = 64)]
    pub pattern_sha256: Option<String>,
    /// Duration, s: truncates the pattern, or repeats it if it is finite. Without it the pattern plays once; one without end must be the
    /// only item.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub seconds: Option<f64>,
    /// Multiplies the amplitude of every drive; without it 1.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub scale: Option<f64>,
    /// Pause from the end of all items before it, or from the play's onset, ms; without it 0. Excludes `start_ms`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1e11)]
    pub gap_ms: Option<f64>,
    /// Time from the play's onset to the item's, ms. Excludes `gap_ms`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1e11)]
    pub start_ms: Option<f64>,
    /// What the trigger output gives at the item's onset; without it one pulse of 10 ms, or of half the time to the next onset if that
    /// is shorter.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = trigger::schema)]
    pub trigger: Option<TriggerRequest>,
}

/// When a play begins, and how it is played.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Terms {
    /// Onset on the device's clock, ticks. Excludes `at_ms` and `at_monotonic_ns`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub at_tick: Option<u64>,
    /// Delay from the request to the onset, ms. Excludes `at_tick` and `at_monotonic_ns`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 3_600_000.0)]
    pub at_ms: Option<f64>,
    /// Onset on the host's `CLOCK_MONOTONIC`, ns. The daemon takes the nearest tick by its estimate of the device's clock when it
    /// accepts the play; the receipt shows that tick as the requested one. Excludes `at_tick` and `at_ms`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub at_monotonic_ns: Option<u64>,
    /// Delay from an edge of the trigger input to the onset, ms, to the nearest tick: the first edge after the daemon has taken the play and
    /// those before it are over. The daemon names the least delay, about 5 ms. Excludes `at_tick`, `at_ms` and `at_monotonic_ns`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 3_600_000.0)]
    pub on_edge_ms: Option<f64>,
    /// Whether the first edge of the trigger input after the onset stops the play and clears the queue, as `POST /v1/stop` does.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "std::ops::Not::not")]
    pub stop_on_edge: bool,
    /// The boot that `at_tick` belongs to, as `device.boot` in the status. The daemon refuses another one.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub boot: Option<u32>,
    /// Whether the play may be without end: without it the daemon refuses a pattern without end that has no `seconds`.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "std::ops::Not::not")]
    pub endless: bool,
    /// Which strokes to play at the end of each item: those that are `whole` by then (the default), or all that begin before, to `cover` it.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "Fit::is_whole")]
    pub fit: Fit,
    /// What to do when strokes come late: `drop` them (the default) or `abort` the play.
    #[serde(default, deserialize_with = "null_as_default")]
    pub late: LatePolicy,
    /// Whether to stop the running play and clear the queue first.
    #[serde(default, deserialize_with = "null_as_default")]
    pub replace: bool,
    /// Whether to play without corrections from telemetry.
    #[serde(default, deserialize_with = "null_as_default")]
    pub open_loop: bool,
    /// The session that the play belongs to. Without it the running one, if any; the daemon refuses another one.
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
    /// How long a pin may stay above rest without a pulse, ms: then the device lowers it by itself. Without it as long as the play
    /// needs. Less than the play needs is refused.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1.0, maximum = 60_000.0)]
    pub hold_ms: Option<f64>,
}

/// Which strokes a play has at its end: those that have ended by then (`whole`), or those that begin before (`cover`), which it then
/// plays to their end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Fit {
    /// Strokes that have ended by the end of the play: it is a little shorter than ordered.
    #[default]
    Whole,
    /// Strokes that begin before the end of the play: it is a little longer than ordered.
    Cover,
}

impl Fit {
    const fn is_whole(&self) -> bool {
        matches!(self, Self::Whole)
    }
}

/// What to do when strokes come late: `drop` them and go on, or `abort` the play, return the pins to rest and disarm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum LatePolicy {
    /// Drop late strokes whole and go on.
    #[default]
    Drop,
    /// End the play: return the pins to rest and disarm.
    Abort,
}

impl Order {
    /// The order to play this item.
    pub fn new(item: Item, terms: Terms) -> Self {
        Self { name: None, items: vec![item], terms }
    }

    /// Reads a body.
    ///
    /// # Errors
    /// A `bad-request` that names the item and the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        check_packed(body)?;
        Self::of_keys(read(body)?)
    }

    /// Reads a file: TOML with a table `[[items]]` for each item, or JSON as in a body.
    ///
    /// # Errors
    /// A `bad-request` that names the item and the key.
    pub fn parse_file(text: &str) -> Result<Self, Problem> {
        if text.trim_start().starts_with('{') {
            return Self::parse(text.as_bytes());
        }
        document::from_toml(text, |_| "it")
            .map_err(|fault: document::KeyError<Infallible>| bad(fault.in_file(None).to_string()))
            .and_then(|document::Table(keys)| Self::of_keys(keys))
    }

    fn of_keys(keys: Keys) -> Result<Self, Problem> {
        let order = if keys.0.contains_key("items") {
            let (Listed { name, items }, terms) = split(keys, [keys_of::<Listed>(), keys_of::<Terms>()])?;
            Self { name, items, terms }
        } else {
            let (item, terms): (Item, _) = split(keys, [keys_of::<Item>(), keys_of::<Terms>()])?;
            if item.pattern.is_none() {
                return Err(bad(
                    "`pattern` is null or false: must be the name of a pattern, or a pattern; a blank item stands in `items`",
                ));
            }
            Self::new(item, terms)
        };
        order.check()?;
        Ok(order)
    }

    fn check(&self) -> Result<(), Problem> {
        let Self { name, items, terms } = self;
        terms.check()?;
        if items.is_empty() {
            return Err(bad("`items` is empty: add an item"));
        }
        if items.len() > MAX_ITEMS {
            return Err(bad(format!("`items` has more than {MAX_ITEMS} items: divide it")));
        }
        let letter = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-';
        if name.as_ref().is_some_and(|name| !(1..=64).contains(&name.len()) || !name.bytes().all(letter)) {
            return Err(bad("`name` must be 1 to 64 of a-z, 0-9 and -"));
        }
        for (number, item) in items.iter().enumerate() {
            item.check().map_err(|detail| self.at(number, bad(detail)))?;
        }
        Ok(())
    }

    /// The problem of an item, with its number if there are several.
    pub fn at(&self, number: usize, problem: Problem) -> Problem {
        if self.items.len() == 1 {
            return problem;
        }
        Problem { detail: format!("`items[{number}]`: {}", problem.detail), ..problem }
    }

    /// The one item of an order whose receipt lists no items: its pattern gives the play its name.
    pub fn one(&self) -> Option<&Item> {
        match &self.items[..] {
            [item] if self.name.is_none() && item.pattern.is_some() => Some(item),
            _ => None,
        }
    }

    /// The order as the session record keeps it: of several items only their number, because their ends record the rest.
    pub fn recorded(&self) -> Value {
        if self.one().is_some() {
            return serde_json::to_value(self).unwrap_or_default();
        }
        // Plain data can be written.
        let mut keys = serde_json::to_value(&self.terms).unwrap_or_default();
        keys["name"] = json!(self.name);
        keys["items"] = json!(self.items.len());
        keys
    }
}

/// The keys that an order of several items has besides its terms.
#[derive(Deserialize)]
struct Listed {
    name: Option<String>,
    items: Vec<Item>,
}

impl Serialize for Order {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Flat<'o, T> {
            #[serde(flatten)]
            of: &'o T,
            #[serde(flatten)]
            terms: &'o Terms,
        }
        let Self { name, items, terms } = self;
        match self.one() {
            Some(item) => Flat { of: item, terms }.serialize(to),
            None => Flat { of: &json!({"name": name, "items": items}), terms }.serialize(to),
        }
    }
}

/// The terms of a live play.
pub(crate) const LIVE_TERMS: [&str; 6] = ["late", "replace", "open_loop", "session", "trial", "labels"];

impl Item {
    /// An item that plays the pattern of this name once.
    pub fn of(pattern: impl Into<PatternChoice>) -> Self {
        Self { pattern: Some(pattern.into()), ..Self::default() }
    }

    fn check(&self) -> Result<(), String> {
        if self.gap_ms.is_some() && self.start_ms.is_some() {
            return Err("`gap_ms` and `start_ms` exclude each other: leave one out".to_owned());
        }
        check_sha256(self.pattern_sha256.as_deref()).map_err(str::to_owned)?;
        match &self.pattern {
            Some(PatternChoice::Inline(_)) if self.pattern_sha256.is_some() => {
                return Err("`pattern_sha256` goes with the name of a pattern: leave it out".to_owned());
            }
            Some(_) => {}
            None if self.seconds.is_none() => return Err("a blank item needs `seconds`".to_owned()),
            None if self.pattern_sha256.is_some() || self.scale.is_some() => {
                return Err(
                    "a blank item has neither `pattern_sha256` nor `scale`: leave them out".to_owned()
                );
            }
            None => {}
        }
        if let Some(seconds) = self.seconds {
            let good = (0.0..=MAX_SECONDS).contains(&seconds);
            document::in_range("seconds", seconds, good, "0 to 100000000 s")
                .map_err(|fault| problem(fault).detail)?;
        }
        check_scale(self.scale)?;
        check_trigger(self.trigger)
    }
}

impl Terms {
    pub(crate) fn check(&self) -> Result<(), Problem> {
        check_onset(self.at_tick, self.at_ms, self.at_monotonic_ns, self.on_edge_ms)?;
        check_labels(&self.labels)?;
        let Some(hold_ms) = self.hold_ms else { return Ok(()) };
        document::in_range("hold_ms", hold_ms, HOLD_MS.contains(&hold_ms), "1 to 60000 ms").map_err(problem)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::MAX_AT_MS;

    #[test]
    fn errors_name_the_key() {
        let read = |text: &str| Order::parse(text.as_bytes());
        let request =
            read(r#"{"pattern":"edge-45","seconds":2,"late":"abort","session":null,"replace":null}"#)
                .unwrap();
        assert_eq!(
            (request.items[0].seconds, request.terms.late, request.terms.replace),
            (Some(2.0), LatePolicy::Abort, false)
        );
        let json = serde_json::to_vec(&request).unwrap();
        assert_eq!(Order::parse(&json).unwrap(), request);
        for (text, says) in [
            (r#"{"pattern":"a","secnods":2}"#, "unknown key `secnods`: did you mean `seconds`?"),
            (r#"{"seconds":2}"#, "`pattern` is missing: add the name of a pattern"),
            (r#"{"pattern":null}"#, "`pattern` is null"),
            (r#"{"pattern":"a","seconds":"2"}"#, "`seconds` is string \"2\": must be a number"),
            (
                r#"{"pattern":"a","boot":-1}"#,
                "`boot` is integer `-1`: must be a whole number, 0 to 4294967295",
            ),
            (r#"{"pattern":"a","at_tick":1.5}"#, "`at_tick` is floating point `1.5`: must be a whole number"),
            (r#"{"pattern":"a","seconds":1,"pattern":"b"}"#, "`pattern` is there twice: leave one out"),
            (
                r#"{"pattern":"a","late":"never"}"#,
                "`late`: unknown variant `never`, expected `drop` or `abort`",
            ),
            (r#"{"pattern":"a","replace":1}"#, "`replace` is integer `1`: must be true or false"),
            (r#"{"pattern":"a","at_ms":-1}"#, "`at_ms` is -1: must be 0 to 3600000 ms"),
            (r#"{"pattern":"a","at_ms":1,"at_tick":1}"#, "`at_tick` and `at_ms` exclude each other"),
            (r#"{"pattern":"a","pattern_sha256":"9F"}"#, "`pattern_sha256` must be 64 of 0-9 and a-f"),
            (r#"{"pattern":"a","scale":-0.1}"#, "`scale` is -0.1: must be 0 to 1"),
            (r#"{"pattern":"a","trigger":{"code":0}}"#, "`trigger`: `code` must be 1 to 255"),
            (r#"{"pattern":"a","at_ms":1,"at_monotonic_ns":1}"#, "`at_ms` and `at_monotonic_ns` exclude"),
            (
                "[]",
                "the body is not a JSON object: is sequence: must be a table of keys and values; see GET /v1/openapi.json",
            ),
            ("", "the body is not a JSON object"),
            (r#"{"pattern":"a"}}"#, "the body is not a JSON object"),
        ] {
            let problem = read(text).unwrap_err();
            assert!(problem.detail.contains(says), "{text}: {}", problem.detail);
            assert_eq!((problem.code.as_str(), problem.status), ("bad-request", 400));
            assert!(!problem.detail.contains('\n'));
        }
        assert!(Order::parse(b"\xff").unwrap_err().detail.contains("not UTF-8"));
        // The message above says so.
        assert_eq!(MAX_AT_MS.to_string(), "3600000");
    }

    #[test]
    fn errors_in_a_list_name_the_item_and_the_key() {
        let read = |text: &str| Order::parse(text.as_bytes());
        let text = r#"{"items":[{"pattern":"a"},{"pattern":"b","seconds":1,"scale":0.5,"gap_ms":2.5,"trigger":{"code":3}},
            {"pattern":"a","start_ms":1e3,"trigger":false}],"name":"block-1","at_tick":5}"#;
        let request = read(text).unwrap();
        assert_eq!((request.items.len(), request.items[1].gap_ms), (3, Some(2.5)));
        assert_eq!(read(&serde_json::to_string(&request).unwrap()).unwrap(), request);
        for (text, says) in [
            (r#"{"items":[{"pattern":"a"},{"seconds":1}]}"#, "`items[1].pattern` is missing"),
            (r#"{"items":[{"pattern":"a","gap":1}]}"#, "unknown key `gap`: did you mean `gap_ms`?"),
            (r#"{"items":[]}"#, "`items` is empty"),
            (r#"{"items":[{"pattern":"a","gap_ms":1,"start_ms":1}]}"#, "`gap_ms` and `start_ms` exclude"),
            (r#"{"items":[{"pattern":"a","scale":1.5}]}"#, "`scale` is 1.5: must be 0 to 1"),
            (
                r#"{"items":[{"pattern":"a"},{"pattern":"a","trigger":{"width_ms":0}}]}"#,
                "`items[1]`: `trigger`: `width_ms` must be",
            ),
            (r#"{"items":[{"pattern":"a"}],"at_ms":1,"at_tick":1}"#, "exclude each other"),
            (r#"{"items":[{"pattern":"a"}],"name":"A b"}"#, "`name` must be"),
            (r#"{"items":[{"pattern":"a"}],"hold_ms":0}"#, "`hold_ms` is 0: must be 1 to 60000 ms"),
            (r#"{"items":[{"pattern":true,"seconds":1}]}"#, "`items[0].pattern` is boolean `true`"),
            (r#"{"items":7}"#, "`items` is integer `7`: must be a list"),
        ] {
            let problem = read(text).unwrap_err();
            assert!(problem.detail.contains(says), "{text}: {}", problem.detail);
            assert_eq!(problem.code, "bad-request");
        }
        let file = "name = \"block-1\"\nat_tick = 5\n[[items]]\npattern = \"a\"\n[[items]]\npattern = \"b\"\nseconds = 1.0\n\
                    scale = 0.5\ngap_ms = 2.5\ntrigger.code = 3\n[[items]]\npattern = \"a\"\nstart_ms = 1e3\ntrigger = false\n";
        assert_eq!(Order::parse_file(file).unwrap(), request);
        assert_eq!(Order::parse_file(text).unwrap(), request);
        // TOML has no null.
        let blank = "strict = true\nhold_ms = 500\n[[items]]\npattern = false\nseconds = 0.5\n";
        let blank = Order::parse_file(blank).unwrap();
        assert_eq!(
            (blank.items[0].pattern.as_ref(), blank.terms.strict, blank.terms.hold_ms),
            (None, true, Some(500.0))
        );
        assert_eq!(read(&serde_json::to_string(&blank).unwrap()).unwrap(), blank);
        let wrong = Order::parse_file("[[items]]\npatern = \"a\"\n").unwrap_err();
        assert!(wrong.detail.contains("did you mean `pattern`?"), "{wrong}");
        let broken = Order::parse_file("[[items]\n").unwrap_err().detail;
        assert!(broken.starts_with("not TOML: "), "{broken}");
        let many = |count| format!("{{\"items\":[{}]}}", vec![r#"{"pattern":"a"}"#; count].join(","));
        assert!(read(&many(MAX_ITEMS)).is_ok());
        assert!(read(&many(MAX_ITEMS + 1)).unwrap_err().detail.contains("more than 4096 items"));
    }
}
