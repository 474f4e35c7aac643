//! The doctor: what of this machine, its service, its daemon and its device could keep a pattern from being played in time.
//!
//! It measures how late timers wake a thread, alone, and looks at the rest after that: at this [`host`], at what is
//! installed on it ([`service`]), at what a [`daemon`] says, at [`port`]s, and at a [`board`], unless it is a daemon's. It arms
//! nothing, moves nothing and mends nothing.
//!
//! Invariant: every finding that is not `ok` says what to do; it is a go only if none says `FAIL`.

mod board;
mod daemon;
mod host;
mod port;
mod service;

use super::{Plain, give, text};
use anyhow::Result;
use meissner_api::Status;
use meissner_client::ClientError;
use meissner_client::access::Me;
use meissner_stream::device::Spec;
use meissner_stream::diagnostics::{Drift, RoundTripStats};
use serde::Serialize;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Level {
    Ok,
    /// It plays, but perhaps not in time, or not as it is.
    Warn,
    /// It does not play.
    Fail,
}

#[derive(Debug, Serialize)]
struct Finding {
    what: &'static str,
    level: Level,
    found: String,
    /// What to do; empty if nothing.
    advice: String,
}

impl Finding {
    fn new(what: &'static str, level: Level, found: impl Into<String>, advice: &str) -> Self {
        let advice = if level == Level::Ok { String::new() } else { advice.to_owned() };
        Self { what, level, found: found.into(), advice }
    }

    fn ok(what: &'static str, found: impl Into<String>) -> Self {
        Self::new(what, Level::Ok, found, "")
    }

    fn warn(what: &'static str, found: impl Into<String>, advice: impl AsRef<str>) -> Self {
        Self::new(what, Level::Warn, found, advice.as_ref())
    }

    fn fail(what: &'static str, found: impl Into<String>, advice: impl AsRef<str>) -> Self {
        Self::new(what, Level::Fail, found, advice.as_ref())
    }
}

/// What was measured on the device.
#[derive(Debug, Serialize)]
struct Examined {
    kind: String,
    serial_number: Option<String>,
    firmware: String,
    build: String,
    protocol: u8,
    boot: u32,
    simulated: bool,
    telemetry: bool,
    pool: u16,
    horizon_ticks: u8,
    round_trip: RoundTripStats,
    throughput_bytes_per_s: Option<u32>,
    drift: Drift,
}

#[derive(Debug, Serialize)]
struct Report {
    /// Go.
    ok: bool,
    wake_up: host::WakeUp,
    /// Null if the device is a daemon's, or there is none.
    device: Option<Examined>,
    findings: Vec<Finding>,
}

/// `asked`: which device; without it, what a daemon has, else the first board. Wake-ups are measured for `time`.
pub(super) fn run(asked: Option<Spec>, time: Duration, plain: &Plain) -> Result<ExitCode> {
    let root = Path::new("/");
    let (realtime, wake_up) = host::measure(time);
    let status: Result<Status, ClientError> = plain.client()?.get("/v1/status");
    let granted = status.as_ref().ok().and_then(|status| status.realtime);
    let units = service::units(root);
    let mut findings = Vec::from(host::rights(realtime, granted, units.is_installed()));
    findings.push(host::timers(&wake_up));
    findings.push(host::governor(root));
    findings.extend(service::findings(root, &units));
    let denied = daemon::is_denied(&status);
    // Whoever is refused is told about groups by that.
    if !denied && let Some(me) = Me::look_up() {
        findings.extend(service::group(root, &units, &me));
    }
    let daemons = daemon::findings(root, &mut findings, asked.is_none(), status, &units);
    findings.extend(port::autosuspend(root));
    findings.extend(port::modem_manager(root));
    let device = match asked {
        None if daemons.is_some() => None,
        None => board::examine(root, &Spec::Board, &mut findings),
        Some(spec) => board::examine(root, &spec, &mut findings),
    };
    let simulated = match &device {
        Some(examined) => examined.simulated,
        None => daemons.and_then(|status| status.device).is_some_and(|device| device.simulated),
    };
    let ok = findings.iter().all(|finding| finding.level != Level::Fail);
    let report = Report { ok, wake_up, device, findings };
    let verdict = match (ok, simulated) {
        (true, false) => "go",
        (true, true) => "go, on a simulated device",
        (false, _) => "no go: see what says FAIL",
    };
    give(plain.output.json, &report, || format!("{}\n{verdict}", lines(&report.findings)))?;
    Ok(if ok { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn lines(findings: &[Finding]) -> String {
    let line = |finding: &Finding| {
        let mark = match finding.level {
            Level::Ok => "ok",
            Level::Warn => "warn",
            Level::Fail => "FAIL",
        };
        let advice =
            if finding.advice.is_empty() { String::new() } else { format!(" -> {}", finding.advice) };
        vec![mark.to_owned(), finding.what.to_owned(), format!("{}{advice}", finding.found)]
    };
    text::columns(&[], findings.iter().map(line))
}

/// What tests of the rooms share: a machine that is not there.
#[cfg(test)]
mod fake {
    use std::fs;
    use std::path::Path;

    /// Writes a file, and the directories it needs, below a root.
    pub(super) fn write(root: &Path, path: &str, text: &str) {
        let file = root.join(path);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    }

    /// A finding on one line: level, what, found, advice.
    pub(super) fn line(finding: &super::Finding) -> String {
        let super::Finding { what, level, found, advice } = finding;
        assert_eq!(*level == super::Level::Ok, advice.is_empty(), "{finding:?}");
        format!("{level:?} {what}: {found} -> {advice}")
    }

    pub(super) fn all<'a>(findings: impl IntoIterator<Item = &'a super::Finding>) -> Vec<String> {
        findings.into_iter().map(line).collect()
    }
}
