//! Request bodies: JSON objects, read with serde.
//!
//! [`PlayRequest::parse`], [`ArmRequest::parse`], [`DisarmRequest::parse`], [`ResetRequest::parse`], [`CalibrateRequest::parse`] and [`parse_empty`] read a body. A key that is null
//! counts as absent, but a number may not be null ([`given`]). An error is one line that names the key; for an unknown key it offers the nearest known one.

use crate::body::{
    MAX_NAME, bad, check_labels, check_onset, check_scale, check_sha256, check_trigger, null_as_default,
    problem, read, read_or_default,
};
use crate::pattern_choice::{self, PatternChoice, check_packed};
use crate::problem::Problem;
use crate::trigger::{self, TriggerRequest};
use meissner_input::document::{self, given};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use utoipa::ToSchema;
use utoipa::openapi::schema::{ArrayBuilder, ObjectBuilder, Schema, Type};

/// A pattern to play, when, and how.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"pattern": "edge-45", "seconds": 2.0, "at_ms": 500.0, "late": "abort"})))]
pub struct PlayRequest {
    /// The pattern's name; `rendering:ID` for the pattern of a rendering; or the pattern itself.
    #[schema(schema_with = pattern_choice::schema)]
    pub pattern: PatternChoice,
    /// Play the text with this SHA-256 (hexadecimal): the stored pattern, or else the text that the session record keeps. Without
    /// either the daemon refuses. Without the key: the stored pattern.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 64, max_length = 64)]
    pub pattern_sha256: Option<String>,
    /// Duration, s: truncates the pattern, or repeats it if it is finite. Without it the pattern plays once, or without end.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub seconds: Option<f64>,
    /// Multiplies the amplitude of every drive; without it 1.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub scale: Option<f64>,
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
    #[serde(default, deserialize_with = "null_as_default")]
    pub endless: bool,
    /// Which strokes to play at the end: those that are `whole` by then (the default), or all that begin before, to `cover` it.
    #[serde(default, deserialize_with = "null_as_default")]
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
    /// What the trigger output gives at the onset; without it one pulse of 10 ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = trigger::schema)]
    pub trigger: Option<TriggerRequest>,
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

/// The range of `hold_ms`, ms: what the device allows at most.
pub const HOLD_MS: RangeInclusive<f64> = 1.0..=60_000.0;

/// Refuses a `hold_ms` that is out of range.
pub(crate) fn check_hold(hold_ms: Option<f64>) -> Result<(), Problem> {
    let Some(hold_ms) = hold_ms else { return Ok(()) };
    document::in_range("hold_ms", hold_ms, HOLD_MS.contains(&hold_ms), "1 to 60000 ms").map_err(problem)
}

/// Refuses the SHA-256 of a text beside the text itself.
pub(crate) fn check_text_of(pattern: &PatternChoice, sha256: Option<&str>) -> Result<(), &'static str> {
    match (pattern, sha256) {
        (PatternChoice::Inline(_), Some(_)) => {
            Err("`pattern_sha256` goes with the name of a pattern: leave it out")
        }
        _ => Ok(()),
    }
}

/// How long `GET /v1/plays/{id}` may wait for the end of the play, s.
pub const MAX_WAIT_S: f64 = 60.0;

impl PlayRequest {
    /// Reads a body.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        check_packed(body)?;
        let request: Self = read(body)?;
        check_onset(request.at_tick, request.at_ms, request.at_monotonic_ns, request.on_edge_ms)?;
        check_labels(&request.labels)?;
        check_sha256(request.pattern_sha256.as_deref()).map_err(bad)?;
        check_text_of(&request.pattern, request.pattern_sha256.as_deref()).map_err(bad)?;
        check_hold(request.hold_ms)?;
        check_scale(request.scale).and_then(|()| check_trigger(request.trigger)).map_err(bad)?;
        Ok(request)
    }
}

/// How to arm, and whether the motors may stay armed without this client.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"assume_rest": true, "checked": "Ada", "silence_s": 10.0})))]
pub struct ArmRequest {
    /// Whether to take every pin as at rest: only after somebody has levelled them.
    #[serde(default, deserialize_with = "null_as_default")]
    pub assume_rest: bool,
    /// Who has looked at the pins and found them level, in 1 to 100 characters. The log and the session record keep it.
    /// `assume_rest` needs it once pins may have drifted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 100)]
    pub checked: Option<String>,
    /// The daemon stops and disarms when it has heard nothing of this client for so long, s; without it `armed_silence_s` of the
    /// configuration. Excludes `unattended`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1.0, maximum = 86_400.0)]
    pub silence_s: Option<f64>,
    /// Whether the motors may stay armed however long this client is silent.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "std::ops::Not::not")]
    pub unattended: bool,
}

/// The range of `silence_s`, s: a client that sends a request each quarter of it is not taken for dead because its machine is busy.
pub const SILENCE_S: RangeInclusive<f64> = 1.0..=86_400.0;

impl ArmRequest {
    /// Reads a body; an empty one gives the defaults.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let request: Self = read_or_default(body)?;
        if let Some(silence_s) = request.silence_s {
            if request.unattended {
                return Err(bad("`silence_s` and `unattended` exclude each other: leave one out"));
            }
            let good = SILENCE_S.contains(&silence_s);
            document::in_range("silence_s", silence_s, good, "1 to 86400 s").map_err(problem)?;
        }
        match &request.checked {
            Some(_) if !request.assume_rest => {
                Err(bad("`checked` goes with `assume_rest`: leave it out, or add \"assume_rest\": true"))
            }
            Some(name) if name.trim().is_empty() || name.chars().count() > MAX_NAME => {
                Err(bad("`checked` must name who has looked at the pins, in 1 to 100 characters"))
            }
            _ => Ok(request),
        }
    }
}

/// What to disarm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"own": true})))]
pub struct DisarmRequest {
    /// Whether to take back only what this client has armed: while another client that has armed is there, the motors stay armed for it,
    /// and only the plays of this client end.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "std::ops::Not::not")]
    pub own: bool,
}

impl DisarmRequest {
    /// Reads a body; an empty one gives the defaults.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        read_or_default(body)
    }
}

/// How to reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"force": true})))]
pub struct ResetRequest {
    /// Whether to reset although another terminal or program has ordered an emergency stop since the last reset. A person decides
    /// that.
    #[serde(default, deserialize_with = "null_as_default")]
    pub force: bool,
    /// Whether pins that stand above rest are left where they are, until the next `arm`. Otherwise the device returns them.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "std::ops::Not::not")]
    pub keep: bool,
    /// The emergency stops that this decision knows of, as `estops` in the status. The daemon refuses the reset if one came later.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub estops_seen: Option<u64>,
}

impl ResetRequest {
    /// Reads a body; an empty one gives the defaults.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        read_or_default(body)
    }
}

/// When an edge comes to the trigger input of a simulated array; without a key at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"at_ms": 250.0})))]
pub struct EdgeRequest {
    /// The tick of the edge, at most an hour ahead; one that has passed counts as now. Excludes `at_ms`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub at_tick: Option<u64>,
    /// Delay from the request to the edge, ms. Excludes `at_tick`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 3_600_000.0)]
    pub at_ms: Option<f64>,
}

impl EdgeRequest {
    /// Reads a body; an empty one gives the defaults.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let request: Self = read_or_default(body)?;
        check_onset(request.at_tick, request.at_ms, None, None)?;
        Ok(request)
    }
}

/// What to calibrate, and how.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"motor": 3, "pulses": [14, 70, 140], "repetitions": 4})))]
pub struct CalibrateRequest {
    /// The one motor to calibrate; without it, all motors.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 63)]
    pub motor: Option<u8>,
    /// Burst lengths, pulses, at least two different ones, each from `least_pulses` of the array's motors to 200; without it ten numbers, for the paper's motors 14, 28, ... 140.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = pulses_schema)]
    pub pulses: Option<Vec<u16>>,
    /// Groups of bursts per burst length; without it 2. Burst lengths times repetitions are at most 100.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 50)]
    pub repetitions: Option<u16>,
    /// Whether a laser measures: the daemon plays the bursts of the one `motor`, measures and stores nothing, and needs no
    /// telemetry. Without `pulses` and `repetitions` they are 7, 35, 42, ... 91 and 5.
    #[serde(default, deserialize_with = "null_as_default")]
    pub laser: bool,
    /// The session that its client believes to be running: the daemon refuses another one, or none. A calibration belongs to no session.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
}

fn pulses_schema() -> Schema {
    let pulses = ObjectBuilder::new().schema_type(Type::Integer).minimum(Some(1)).maximum(Some(200));
    let text = "Burst lengths, pulses, at least two different ones, each from `least_pulses` of the array's motors to 200; without it ten numbers, for the paper's motors 14, 28, ... 140.";
    ArrayBuilder::new().items(pulses).min_items(Some(2)).max_items(Some(100)).description(Some(text)).into()
}

impl CalibrateRequest {
    /// Reads a body; an empty one gives the defaults.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        read_or_default(body)
    }
}

/// Reads the body of a request without arguments: empty, or `{}`.
///
/// # Errors
/// A `bad-request` if the body holds anything else.
pub fn parse_empty(body: &[u8]) -> Result<(), Problem> {
    #[derive(Default, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct NoArguments {}
    let NoArguments {} = read_or_default(body)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::MAX_AT_MS;

    #[test]
    fn errors_name_the_key() {
        let read = |text: &str| PlayRequest::parse(text.as_bytes());
        let request =
            read(r#"{"pattern":"edge-45","seconds":2,"late":"abort","session":null,"replace":null}"#)
                .unwrap();
        assert_eq!(
            (request.pattern.name(), request.seconds, request.late, request.replace),
            ("edge-45", Some(2.0), LatePolicy::Abort, false)
        );
        let json = serde_json::to_vec(&request).unwrap();
        assert_eq!(PlayRequest::parse(&json).unwrap(), request);
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
        assert!(PlayRequest::parse(b"\xff").unwrap_err().detail.contains("not UTF-8"));
        // The message above says so.
        assert_eq!(MAX_AT_MS.to_string(), "3600000");
    }

    /// Each key and each kind of value, with text that would break a line or hide it, and with much of it.
    #[test]
    fn foreign_text_is_escaped_and_cut() {
        for text in ["x\n2026 INFO estop by ada\r\u{1b}[2J\u{9b}\u{2028}\u{202e}\u{7f}", &"x".repeat(5000)] {
            let text = serde_json::to_string(text).unwrap();
            let long = text.len() > 5000;
            let keys = [
                "pattern",
                "seconds",
                "at_tick",
                "at_ms",
                "at_monotonic_ns",
                "boot",
                "endless",
                "fit",
                "late",
                "replace",
                "open_loop",
                "scale",
                "trigger",
            ];
            let values = keys.iter().flat_map(|key| {
                ["TEXT", "[TEXT]", "{TEXT: TEXT}"].map(|value| format!("{{\"{key}\": {value}}}"))
            });
            let whole = [
                "TEXT",
                "[TEXT]",
                "{TEXT: 1}",
                "{TEXT: {TEXT: TEXT}}",
                "{\"pattern\": \"a\"} TEXT",
                "TEXT: 1",
            ];
            for body in values.chain(whole.map(str::to_owned)) {
                let body = body.replace("TEXT", &text).into_bytes();
                let parsed = [
                    PlayRequest::parse(&body).err(),
                    ArmRequest::parse(&body).err(),
                    CalibrateRequest::parse(&body).err(),
                    parse_empty(&body).err(),
                ];
                for problem in parsed.into_iter().flatten() {
                    let detail = &problem.detail;
                    assert!(detail.chars().all(meissner_input::message::is_plain), "{detail:?}");
                    assert!(!long || detail.len() < 400, "{}: {detail}", detail.len());
                }
            }
        }
        let late = PlayRequest::parse(br#"{"late": "x\n\u001b[1m"}"#).unwrap_err();
        assert_eq!(late.detail, r"`late`: unknown variant `x\n\u{1b}[1m`, expected `drop` or `abort`");
    }

    #[test]
    fn commands_without_arguments_take_none() {
        assert!(parse_empty(b"").is_ok() && parse_empty(b"{}").is_ok());
        let problem = parse_empty(br#"{"now":true}"#).unwrap_err();
        assert_eq!(problem.detail, "unknown key `now`: leave it out, no keys are known here");
        assert!(parse_empty(b"null").unwrap_err().detail.contains("not a JSON object"));
        assert!(ArmRequest::parse(b"").is_ok_and(|arm| !arm.assume_rest));
        assert!(ArmRequest::parse(br#"{"assume_rest":true}"#).unwrap().assume_rest);
        let checked = |text: &str| ArmRequest::parse(text.as_bytes()).map_err(|problem| problem.detail);
        let ada = checked(r#"{"assume_rest":true,"checked":"Ada"}"#).unwrap();
        assert_eq!(ada.checked.as_deref(), Some("Ada"));
        assert!(checked(r#"{"checked":"Ada"}"#).unwrap_err().contains("goes with `assume_rest`"));
        for name in ["", " ", &"x".repeat(101)] {
            let text = format!(r#"{{"assume_rest":true,"checked":"{name}"}}"#);
            assert!(checked(&text).unwrap_err().contains("in 1 to 100 characters"), "{name}");
        }
        let silence = |text: &str| ArmRequest::parse(text.as_bytes()).map_err(|problem| problem.detail);
        assert_eq!(silence(r#"{"silence_s":1}"#).unwrap().silence_s, Some(1.0));
        assert!(silence(r#"{"unattended":true}"#).unwrap().unattended);
        assert!(silence(r#"{"silence_s":9,"unattended":true}"#).unwrap_err().contains("exclude each other"));
        for text in ["0.9", "86401", "-1", "1e999", "\"5\""] {
            let line = silence(&format!("{{\"silence_s\":{text}}}")).unwrap_err();
            assert!(line.contains("silence_s") || line.contains("JSON"), "{text}: {line}");
        }
        assert!(ArmRequest::parse(br#"{"assume_rset":true}"#).unwrap_err().detail.contains("`assume_rest`"));
        let motor = CalibrateRequest::parse(br#"{"motor":256}"#).unwrap_err();
        assert_eq!(motor.detail, "`motor` is integer `256`: must be a whole number, 0 to 255");
    }
}
