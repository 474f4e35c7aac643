//! Errors of the API: `application/problem+json` (RFC 9457) with a stable code.
//!
//! The daemon makes a [`Problem`] from a [`Code`] and one line of detail; clients switch on [`Problem::code`].
//!
//! Invariants: a published code keeps its meaning and its HTTP status; a detail is one line of bounded length, even if it quotes a
//! client.

use meissner_input::message::cut;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The page of the book that describes the API; error messages point there.
pub const REFERENCE: &str = "GET /v1/openapi.json";

/// Characters of [`Problem::detail`], at most; three dots follow a longer one.
pub const MAX_DETAIL: usize = 500;

/// Lists each kind of error once: its stable name, its HTTP status and its title.
macro_rules! codes {
    ($($(#[$doc:meta])* $code:ident = $parts:expr,)*) => {
        /// The kinds of errors.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Code {
            $($(#[$doc])* $code,)*
        }

        impl Code {
            /// Every code, in the order of the API reference: by HTTP status.
            pub const ALL: &[Self] = &[$(Self::$code),*];

            /// The code's stable name, its HTTP status and its title.
            pub const fn parts(self) -> (&'static str, u16, &'static str) {
                match self {
                    $(Self::$code => $parts,)*
                }
            }
        }
    };
}

codes! {
    /// The body or the address cannot be read, or a value is out of range.
    BadRequest = ("bad-request", 400, "The request cannot be read"),
    /// A request over the network has no valid access token.
    Unauthorized = ("unauthorized", 401, "An access token is needed"),
    /// A request over the network comes from another site's page, or its token's role does not allow it.
    Forbidden = ("forbidden", 403, "The request is not allowed over the network"),
    /// There is no such route, pattern, play or calibration.
    NotFound = ("not-found", 404, "There is no such thing"),
    /// The route exists, but not with this HTTP method.
    MethodNotAllowed = ("method-not-allowed", 405, "The route does not take this method"),
    /// The body did not arrive within 10 s.
    Slow = ("slow-request", 408, "The request took too long to arrive"),
    /// The name belongs to the built-in library, or another pattern has it.
    Exists = ("exists", 409, "The name is taken"),
    /// The motors are off: arm first.
    Disarmed = ("disarmed", 409, "The motors are disarmed"),
    /// An emergency stop or a fault is latched: reset first.
    Faulted = ("faulted", 409, "An emergency stop or fault is latched"),
    /// Another client has just ordered an emergency stop: find out why, then reset again or with `force`.
    RecentEStop = ("recent-estop", 409, "Another terminal has ordered an emergency stop"),
    /// The device returns pins to rest or carries out another command: try again in a moment.
    Returning = ("returning", 409, "The device returns pins to rest"),
    /// A play is queued, runs or is being measured.
    Playing = ("playing", 409, "A play is queued or running"),
    /// Neither telemetry nor a calibration tells where the pins are, so homing cannot move them.
    NoPositionEstimate = ("nothing-to-go-by", 409, "Nothing tells where the pins are"),
    /// Homing has ended, but some pins are not at rest.
    NotHome = ("not-home", 409, "Not all pins are at rest"),
    /// The pattern is for another array than the daemon's.
    OtherArray = ("other-array", 409, "The pattern is for another array"),
    /// A limit of `[participant]` does not allow the play, or not now.
    ParticipantLimit = ("participant-limit", 409, "A participant's limit does not allow it"),
    /// A session's owner alone may do that.
    SessionExclusive = ("session-exclusive", 409, "Only the session's owner may do that"),
    /// Another session runs, or none.
    SessionRunning = ("session-running", 409, "Another session runs, or none"),
    /// A rendering runs already: wait for its end, or cancel it.
    RenderingRunning = ("rendering-running", 409, "A rendering runs already"),
    /// The play in front has no end.
    BehindEndless = ("behind-endless", 409, "The play in front has no end"),
    /// The requested onset is too close or has passed.
    TooSoon = ("too-soon", 409, "The onset cannot be kept"),
    /// The requested onset lies within a play that is queued.
    Overlaps = ("overlaps", 409, "The onset lies within a queued play"),
    /// The pattern needs more bandwidth than the line to the device carries.
    LineTooSlow = ("line-too-slow", 409, "The line does not carry the pattern"),
    /// `boot` names an earlier start of the device, so `at_tick` belongs to another clock.
    StaleBoot = ("stale-boot", 409, "The device has restarted"),
    /// The device does not know where the pins are: level them and arm with `assume_rest`.
    PositionUnknown = ("position-unknown", 409, "The positions of the pins are unknown"),
    /// The device refused the command for another reason.
    DeviceRefused = ("device-refused", 409, "The device refused"),
    /// Down bursts end at the lower stop, so telemetry cannot show their gain: calibrate without the stop.
    LowerStop = ("lower-stop", 409, "The array has a lower stop"),
    /// A motor would push the lower stop with more pulses per second than `limits.stop_pulses_per_s`.
    PushLimit = ("push-limit", 409, "A play would push the lower stop too much"),
    /// More strokes of all motors would begin within 10 ms than the controller allows.
    TooDense = ("too-dense", 409, "Too many strokes would begin within 10 ms"),
    /// A motor is too slow for a motion of a `strict` play.
    TooSlow = ("too-slow", 409, "A motor is too slow for its motion"),
    /// More motors of a rail or a driver chip would have pulses at once than `array.rail_motors_at_once` or
    /// `array.chip_motors_at_once` allows.
    PowerLimit = ("power-limit", 409, "Too many motors would have pulses at once"),
    /// The device does not measure where its pins are.
    NoTelemetry = ("no-telemetry", 409, "The device has no telemetry"),
    /// The device has no trigger input, so no edge can start or stop a play.
    NoTriggerInput = ("no-trigger-input", 409, "The device has no trigger input"),
    /// Without telemetry and lower stop, a pin that the play drives may be farther from rest than `drift_limit_um`: bring the
    /// pins home, or level them by hand.
    DriftLimit = ("drift-limit", 409, "Pins may be too far from rest"),
    /// Pins have drifted since they were last known to be level: say in `checked` who has looked at them.
    LevelNotChecked = ("level-not-checked", 409, "The level of the pins was not checked"),
    /// The body is larger than the route allows.
    TooLarge = ("too-large", 413, "The request is too large"),
    /// The text is not a valid pattern, or not one of this name.
    BadPattern = ("bad-pattern", 422, "Not a valid pattern"),
    /// The pattern, or the play of it, has no stroke.
    Empty = ("empty", 422, "Nothing would be played"),
    /// The queue holds 16 plays.
    QueueFull = ("queue-full", 429, "Too many plays are queued"),
    /// The daemon cannot read or write its files.
    Store = ("store", 500, "The daemon cannot use its files"),
    /// No device is connected.
    NoDevice = ("no-device", 503, "No device is connected"),
    /// Too many commands wait for the device.
    Busy = ("busy", 503, "Too many commands wait"),
    /// Too many clients are connected.
    TooManyClients = ("too-many-clients", 503, "Too many clients"),
    /// The daemon shuts down.
    ShuttingDown = ("shutting-down", 503, "The daemon shuts down"),
    /// The device did not answer in time.
    Timeout = ("timeout", 504, "The device does not answer"),
}

/// An error, as `application/problem+json` (RFC 9457).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema, thiserror::Error)]
#[error("{detail}")]
#[schema(examples(json!({
    "type": "urn:meissner:problem:bad-request", "title": "The request cannot be read", "status": 400,
    "detail": "unknown key `secnods`: did you mean `seconds`?", "code": "bad-request"
})))]
pub struct Problem {
    /// A URI for the code: `urn:meissner:problem:CODE`.
    #[serde(rename = "type")]
    pub kind: String,
    /// The code's title, the same for every error of this code.
    pub title: String,
    /// The HTTP status.
    #[schema(minimum = 400, maximum = 599)]
    pub status: u16,
    /// What is wrong, where, and what to do: one line.
    pub detail: String,
    /// The code's stable name.
    pub code: String,
}

impl Problem {
    /// An error of this code. The detail is escaped and cut: it may quote what a client sent.
    pub fn new(code: Code, detail: impl AsRef<str>) -> Self {
        let (name, status, title) = code.parts();
        Self {
            kind: format!("urn:meissner:problem:{name}"),
            title: title.to_owned(),
            status,
            detail: cut(detail.as_ref(), MAX_DETAIL),
            code: name.to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_differ_and_stand_by_status() {
        let mut names: Vec<_> = Code::ALL.iter().map(|code| code.parts().0).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Code::ALL.len());
        assert!(Code::ALL.is_sorted_by_key(|code| code.parts().1));
    }

    #[test]
    fn a_detail_is_one_line_of_bounded_length() {
        let problem =
            Problem::new(Code::NotFound, "no `a\n\u{1b}[1m\u{2028}\u{202e}`".to_owned() + &"x".repeat(5000));
        let shown = "no `a\\n\\u{1b}[1m\\u{2028}\\u{202e}`xxx";
        assert!(problem.detail.starts_with(shown) && problem.detail.ends_with("x..."), "{problem}");
        assert!(problem.detail.len() < MAX_DETAIL + 40);
    }
}
