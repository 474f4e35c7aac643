//! The doctor's findings: what could keep a machine, its daemon or its device from playing patterns in time.
//!
//! `GET /v1/doctor` answers with a [`DoctorReport`]; `meissner doctor` prints the same [`Finding`]s.
//!
//! Invariant: a finding that is `ok` has no advice; every other has one.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The verdict of a check. `ok`: nothing is wrong; `warn`: the system plays, but perhaps not in time, or not as it stands; `fail`: it
/// does not play.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Nothing is wrong.
    Ok,
    /// The system plays, but perhaps not in time, or not as it stands.
    Warn,
    /// The system does not play.
    Fail,
}

/// A check and what it found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Finding {
    /// What was checked, for example `governor`. A check may have several findings, and none where there is nothing to check.
    pub what: String,
    /// The verdict.
    pub level: Level,
    /// What was found, in one line.
    pub found: String,
    /// What to do, in one line; empty if the verdict is `ok`.
    pub advice: String,
}

impl Finding {
    /// A finding; `advice` is dropped if the level is `ok`.
    pub fn new(
        what: impl Into<String>,
        level: Level,
        found: impl Into<String>,
        advice: impl AsRef<str>,
    ) -> Self {
        let advice = if level == Level::Ok { "" } else { advice.as_ref() };
        Self { what: what.into(), level, found: found.into(), advice: advice.to_owned() }
    }

    /// Nothing is wrong.
    pub fn ok(what: impl Into<String>, found: impl Into<String>) -> Self {
        Self::new(what, Level::Ok, found, "")
    }

    /// A warning.
    pub fn warn(what: impl Into<String>, found: impl Into<String>, advice: impl AsRef<str>) -> Self {
        Self::new(what, Level::Warn, found, advice)
    }

    /// A failure.
    pub fn fail(what: impl Into<String>, found: impl Into<String>, advice: impl AsRef<str>) -> Self {
        Self::new(what, Level::Fail, found, advice)
    }

    /// `ok` if it is `good`, else a warning.
    pub fn check(
        what: impl Into<String>,
        good: bool,
        found: impl Into<String>,
        advice: impl AsRef<str>,
    ) -> Self {
        Self::new(what, if good { Level::Ok } else { Level::Warn }, found, advice)
    }
}

/// What the daemon found on its machine, about itself and about its device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "ok": true,
    "findings": [
        {"what": "governor", "level": "ok", "found": "performance", "advice": ""},
        {
            "what": "state", "level": "warn", "found": "disarmed (boot), position unknown",
            "advice": "check that all pins are at rest, then `meissner arm --assume-rest`"
        }
    ]
})))]
pub struct DoctorReport {
    /// Whether no finding is a failure.
    pub ok: bool,
    /// The findings: the machine's first, then the daemon's, then its device's.
    pub findings: Vec<Finding>,
}

impl From<Vec<Finding>> for DoctorReport {
    fn from(findings: Vec<Finding>) -> Self {
        Self { ok: findings.iter().all(|finding| finding.level != Level::Fail), findings }
    }
}
