//! Errors of the API: `application/problem+json` with a stable code.
//!
//! Invariant: a published code keeps its meaning and its HTTP status.

use serde::{Deserialize, Serialize};

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
    NoPositionEstimate,
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
            Self::NoPositionEstimate => ("nothing-to-go-by", 409, "Nothing says where the pins are"),
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
