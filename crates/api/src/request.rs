//! Request bodies: JSON objects, read with serde.
//!
//! [`ArmRequest::parse`], [`DisarmRequest::parse`], [`ResetRequest::parse`], [`CalibrateRequest::parse`] and [`parse_empty`] read a body. A key that is null
//! counts as absent, but a number may not be null ([`given`]). An error is one line that names the key; for an unknown key it offers the nearest known one.

use crate::body::{MAX_NAME, bad, check_onset, null_as_default, problem, read_or_default};
use crate::problem::Problem;
use meissner_input::document::{self, given};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use utoipa::ToSchema;
use utoipa::openapi::schema::{ArrayBuilder, ObjectBuilder, Schema, Type};

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
    /// The emergency stops that this decision knows of, as `estop.orders` in the status. The daemon refuses the reset if one came later.
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
    use crate::Order;

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
                    Order::parse(&body).err(),
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
        let late = Order::parse(br#"{"pattern": "a", "late": "x\n\u001b[1m"}"#).unwrap_err();
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
