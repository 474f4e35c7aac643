//! `doctor`: checks what could keep this machine, its service, its daemon or its device from playing patterns in time.
//!
//! It first measures how late [`timers`] wake a thread, while no other check runs. Then it makes the checks that the daemon also
//! makes ([`crate::doctor`]), and those of its user and of a device without a daemon: [`rights`], [`unreachable`] daemons, and the
//! [`board`], unless a daemon has opened it. On request the board tests itself ([`self_test`]). The
//! doctor does not arm, move or repair anything.
//!
//! Invariant: every finding that is not `ok` says what to do; the verdict is `go` only if no finding says `FAIL`.

mod board;
mod rights;
mod self_test;
mod timers;
mod unreachable;

use super::arguments::ClientOptions;
use super::output::give;
use super::text;
use crate::doctor::{daemon, device, machine, service};
use anyhow::Result;
use board::Examined;
use meissner_api::{DoctorReport, Finding, Level, Status};
use meissner_array::spec::Array;
use meissner_client::ClientError;
use meissner_stream::device::Spec;
use serde::Serialize;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

#[derive(Debug, Serialize)]
struct Report {
    /// The report, whose `ok` says whether the verdict is go.
    #[serde(flatten)]
    report: DoctorReport,
    wake_up: timers::WakeUp,
    /// Null if a daemon has the device, or there is none.
    device: Option<Examined>,
}

/// `asked`: the device to check; without it the daemon's, else the first board; `array`: what it should be for. `self_test`: have the board test itself. `time`:
/// how long to measure wake-ups.
pub(super) fn run(
    asked: Option<Spec>,
    array: Array,
    self_test: bool,
    time: Duration,
    options: &ClientOptions,
) -> Result<ExitCode> {
    let root = Path::new("/");
    let (realtime, wake_up) = timers::measure(time);
    let status: Result<Status, ClientError> = options.client()?.get("/v1/status");
    let granted = status.as_ref().ok().map(|status| status.daemon.realtime);
    let units = service::units(root);
    let mut findings = Vec::from(rights::of_user(realtime, granted, units.is_installed()));
    findings.push(timers::finding(&wake_up));
    findings.extend(machine(root, &units));
    let daemons = match status {
        Ok(status) => {
            findings.extend(daemon::findings(root, &status, &units));
            Some(status).filter(|_| asked.is_none())
        }
        Err(error) => {
            findings.push(unreachable::finding(error));
            None
        }
    };
    if let Some(status) = &daemons {
        findings.extend(device::findings(status));
    }
    let device = match asked {
        None if daemons.is_some() => {
            if self_test {
                let advice = "stop the daemon (`systemctl stop meissner`, or end it) and run this again";
                findings.push(Finding::fail("self-test", "a daemon has the board", advice));
            }
            None
        }
        None => board::examine(&Spec::Board, array, self_test, &mut findings),
        Some(spec) => board::examine(&spec, array, self_test, &mut findings),
    };
    let simulated = match &device {
        Some(examined) => examined.device.simulated,
        None => daemons.and_then(|status| status.device).is_some_and(|device| device.simulated),
    };
    let report = Report { report: findings.into(), wake_up, device };
    let ok = report.report.ok;
    let verdict = match (ok, simulated) {
        (true, false) => "go",
        (true, true) => "go, on a simulated device",
        (false, _) => "no go: see the lines marked FAIL",
    };
    give(options.output.json, &report, || format!("{}\n{verdict}", lines(&report.report.findings)))?;
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
        vec![mark.to_owned(), finding.what.clone(), format!("{}{advice}", finding.found)]
    };
    text::columns(&[], findings.iter().map(line))
}
