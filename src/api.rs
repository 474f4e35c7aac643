//! The local API's words: requests, answers, and problems with stable codes.
//!
//! The daemon answers in them and the client reads them; how they travel is not said here. Requests are read
//! key by key, so that an error names the key, and an unknown key the nearest known one.
//!
//! Invariant: a problem's code, once published, keeps its meaning and its HTTP status.

use crate::calibrate::{Plan, Provenance};
use crate::record::{DeviceInfo, NO_DEVICE, Running};
use crate::stream::Realtime;
use crate::stream::port::{ErrorSource, LatePolicy, Refused};
use firmware_protocol::limits::Refusal;
use serde::de::{DeserializeOwned, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use std::fmt;

/// Bytes of a request's body at the most.
pub const MAX_BODY: usize = 1 << 20;
/// Clients connected at the same time, at the most.
pub const MAX_CLIENTS: usize = 64;

/// What can go wrong: its stable name, its HTTP status, its title.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "their titles say it")]
pub enum Code {
    BadRequest,
    BadPattern,
    NotFound,
    MethodNotAllowed,
    Exists,
    TooLarge,
    Slow,
    Disarmed,
    Faulted,
    Returning,
    Playing,
    NothingToGoBy,
    NotHome,
    QueueFull,
    BehindEndless,
    TooSoon,
    Overlaps,
    LineTooSlow,
    StaleBoot,
    PositionUnknown,
    DeviceRefused,
    NoDevice,
    Timeout,
    Busy,
    TooManyClients,
    ShuttingDown,
    Store,
    NoTelemetry,
}

impl Code {
    /// Name, HTTP status and title.
    #[must_use]
    pub const fn parts(self) -> (&'static str, u16, &'static str) {
        match self {
            Self::BadRequest => ("bad-request", 400, "The request cannot be read"),
            Self::BadPattern => ("bad-pattern", 422, "Not a pattern"),
            Self::NotFound => ("not-found", 404, "There is no such thing"),
            Self::MethodNotAllowed => ("method-not-allowed", 405, "Not with this method"),
            Self::Exists => ("exists", 409, "The name is taken"),
            Self::TooLarge => ("too-large", 413, "The request is too large"),
            Self::Slow => ("slow-request", 408, "The request took too long to arrive"),
            Self::Disarmed => ("disarmed", 409, "The motors are disarmed"),
            Self::Faulted => ("faulted", 409, "An emergency stop or fault is latched"),
            Self::Returning => ("returning", 409, "Pins are being returned"),
            Self::Playing => ("playing", 409, "A play is running"),
            Self::NotHome => ("not-home", 409, "Not all pins are home"),
            Self::NothingToGoBy => ("nothing-to-go-by", 409, "Nothing says where the pins are"),
            Self::QueueFull => ("queue-full", 429, "Too many plays are queued"),
            Self::BehindEndless => ("behind-endless", 409, "The play before it has no end"),
            Self::TooSoon => ("too-soon", 409, "The onset cannot be kept"),
            Self::Overlaps => ("overlaps", 409, "The onset lies within a queued play"),
            Self::LineTooSlow => ("line-too-slow", 409, "The line does not carry the pattern"),
            Self::StaleBoot => ("stale-boot", 409, "The device has restarted since"),
            Self::PositionUnknown => ("position-unknown", 409, "Where the pins are is not known"),
            Self::DeviceRefused => ("device-refused", 409, "The device refused"),
            Self::NoDevice => ("no-device", 503, "No device is connected"),
            Self::Timeout => ("timeout", 504, "The device does not answer"),
            Self::Busy => ("busy", 503, "Too many orders wait"),
            Self::TooManyClients => ("too-many-clients", 503, "Too many clients"),
            Self::ShuttingDown => ("shutting-down", 503, "The daemon is ending"),
            Self::NoTelemetry => ("no-telemetry", 409, "Nobody measures how far pins go"),
            Self::Store => ("store", 500, "The pattern directory cannot be used"),
        }
    }
}

/// An error as `application/problem+json` (RFC 9457).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{detail}")]
pub struct Problem {
    /// A URI for its code.
    #[serde(rename = "type")]
    pub kind: String,
    /// The same for every problem of this code.
    pub title: String,
    /// The HTTP status.
    pub status: u16,
    /// What, where, what to do: one line.
    pub detail: String,
    /// Its stable name.
    pub code: String,
}

impl Problem {
    /// A problem of that code.
    #[must_use]
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        let (name, status, title) = code.parts();
        Self {
            kind: format!("urn:meissner:problem:{name}"),
            title: title.to_owned(),
            status,
            detail: detail.into(),
            code: name.to_owned(),
        }
    }
}

impl From<Refused> for Problem {
    fn from(refused: Refused) -> Self {
        let code = match refused {
            Refused::NoDevice => Code::NoDevice,
            Refused::Disarmed => Code::Disarmed,
            Refused::Faulted => Code::Faulted,
            Refused::Returning => Code::Returning,
            Refused::Playing => Code::Playing,
            Refused::NotHome => Code::NotHome,
            Refused::NothingToGoBy => Code::NothingToGoBy,
            Refused::QueueFull => Code::QueueFull,
            Refused::BehindEndless => Code::BehindEndless,
            Refused::TooSoon => Code::TooSoon,
            Refused::TooFar => Code::BadRequest,
            Refused::Overlaps => Code::Overlaps,
            Refused::LineTooSlow { .. } => Code::LineTooSlow,
            Refused::Device(Refusal::PositionUnknown) => Code::PositionUnknown,
            Refused::Device(_) => Code::DeviceRefused,
            Refused::Timeout => Code::Timeout,
        };
        Self::new(code, refused.to_string())
    }
}

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
    pub late: Late,
    /// Stop what runs and clear the queue first.
    pub replace: bool,
    /// No corrections from telemetry.
    pub open_loop: bool,
}

/// What to do when strokes come late.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Late {
    /// Drop them whole and go on.
    #[default]
    Drop,
    /// End the play.
    Abort,
}

impl From<Late> for LatePolicy {
    fn from(late: Late) -> Self {
        match late {
            Late::Drop => Self::Drop,
            Late::Abort => Self::Abort,
        }
    }
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
    /// The bursts' numbers of pulses; without it [`crate::calibrate::DEFAULT_PULSES`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pulses: Option<Vec<u16>>,
    /// How often each is played; without it [`crate::calibrate::DEFAULT_REPETITIONS`].
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

    /// What it asks to be played.
    ///
    /// # Errors
    /// A `bad-request` that says what is wrong with it.
    pub fn plan(&self) -> Result<Plan, Problem> {
        let default = Plan::default();
        let pulses = self.pulses.as_deref().unwrap_or(default.pulses());
        let plan = Plan::new(self.motor, pulses, self.repetitions.unwrap_or(default.repetitions()));
        plan.map_err(|error| bad(error.to_string()))
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

fn quote(text: &str) -> String {
    let shown: String = text.chars().take(64).flat_map(char::escape_debug).collect();
    format!("`{shown}`")
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
    let nearest = |unknown: &str| {
        let piece: String = unknown.chars().take(64).collect();
        known.iter().min_by_key(|known| strsim::damerau_levenshtein(known, &piece))
    };
    match object.keys().find(|key| !known.contains(&key.as_str())) {
        Some(unknown) => match nearest(unknown) {
            Some(near) => Err(bad(format!("unknown key {}: did you mean `{near}`?", quote(unknown)))),
            None => Ok(object),
        },
        None => Ok(object),
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

/// `202` to `POST /v1/play`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Played {
    /// The play's id.
    pub id: u64,
}

/// A play that waits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Waiting {
    /// Its id.
    pub id: u64,
    /// Its pattern.
    pub pattern: String,
}

/// A motor's part of the status.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorStatus {
    /// Estimated rest error.
    pub rest_error_um: f32,
    /// Where the estimate comes from.
    pub source: ErrorSource,
    /// Whether its gains were measured by a calibration that is used.
    #[serde(default)]
    pub calibrated: bool,
}

/// `GET /v1/status`, and the answer to every command but `play`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// `disarmed`, `armed`, `returning`, `faulted`, or `no-device`.
    pub state: String,
    /// Why.
    pub cause: String,
    /// `known` or `unknown`.
    pub position: String,
    /// The connected device.
    pub device: Option<DeviceInfo>,
    /// The device asked for, as `--device` names it.
    #[serde(default)]
    pub wanted: String,
    /// Why no device is connected, and what to do, as it was found last; null if one is, or was not looked for yet.
    #[serde(default)]
    pub missing: Option<String>,
    /// The running play.
    pub play: Option<Running>,
    /// Plays that wait behind it.
    pub queued: Vec<Waiting>,
    /// The device's clock, now; null without a device.
    pub tick: Option<u64>,
    /// How well it is known.
    pub clock_uncertainty_us: Option<f64>,
    /// The lead asked for; while something is played, the lead that is reached.
    pub lead_ms: f64,
    /// The lease.
    pub lease_ms: f64,
    /// What the line to the device was measured to carry, bytes per second; null until it is.
    #[serde(default)]
    pub line_bytes_per_s: Option<u32>,
    /// The motors, by number.
    pub motors: Vec<MotorStatus>,
    /// When the calibration that is used was made, UTC; null if there is none.
    #[serde(default)]
    pub calibrated: Option<String>,
    /// Which real-time means the system granted the daemon; null from an older one.
    #[serde(default)]
    pub realtime: Option<Realtime>,
    /// Why the logbook is not written at present; null if it is, or none is kept.
    #[serde(default)]
    pub logbook_problem: Option<String>,
    /// Where the daemon listens; empty from an older one.
    #[serde(default)]
    pub socket: String,
    /// The daemon's version.
    pub version: String,
    /// The daemon's process.
    pub pid: u32,
}

impl Status {
    /// Whether a device has said who it is and how it stands: before, it takes no orders.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.device.is_some() && self.state != NO_DEVICE && self.tick.is_some()
    }
}

/// What a calibration found of a motor. Gains are what a pulse moves the pin by over what the model says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibratedMotor {
    /// Its number.
    pub motor: u8,
    /// Upwards.
    pub gain_up: f64,
    /// Standard error of that.
    pub gain_up_se: f64,
    /// Downwards.
    pub gain_down: f64,
    /// Standard error of that.
    pub gain_down_se: f64,
    /// Standard deviation of single bursts upwards, as a share of their travel.
    pub relative_sd_up: f64,
    /// Downwards.
    pub relative_sd_down: f64,
}

/// `GET /v1/calibration`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibrationReport {
    /// Where it is stored.
    pub file: String,
    /// Whether bursts are corrected by it.
    pub used: bool,
    /// Why not.
    pub unused: Option<String>,
    /// What it says of each motor that was calibrated.
    pub motors: Vec<CalibratedMotor>,
    /// What it was made by.
    pub provenance: Provenance,
    /// The file's text.
    pub toml: String,
}

/// The answer to `PUT /v1/patterns/NAME`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Imported {
    /// Its name.
    pub name: String,
    /// SHA-256 of its bytes.
    pub sha256: String,
    /// What may not be what was meant.
    pub warnings: Vec<String>,
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
            ("edge-45", Some(2.0), Late::Abort)
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

    #[test]
    fn refusals_have_their_codes() {
        for (refused, code, status) in [
            (Refused::Disarmed, "disarmed", 409),
            (Refused::QueueFull, "queue-full", 429),
            (Refused::NoDevice, "no-device", 503),
            (Refused::Timeout, "timeout", 504),
            (Refused::Device(Refusal::PositionUnknown), "position-unknown", 409),
            (Refused::LineTooSlow { needs: 41_200, carries: 11_300 }, "line-too-slow", 409),
        ] {
            let problem = Problem::from(refused);
            assert_eq!((problem.code.as_str(), problem.status), (code, status));
        }
    }
}
