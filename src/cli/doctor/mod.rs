//! `doctor`: checks what could keep this machine, its service, its daemon or its device from playing patterns in time.
//!
//! It first measures how late timers wake a thread, with nothing beside it. Then it checks [`host`], [`rights`], what is
//! installed ([`service`]), the [`daemon`], [`port`]s, and the [`board`], unless a daemon has the board. On request the board tests
//! itself ([`self_test`]). The doctor arms nothing, moves nothing and repairs nothing.
//!
//! Invariant: every finding that is not `ok` says what to do; the verdict is `go` only if no finding says `FAIL`.

mod board;
mod daemon;
mod finding;
mod host;
mod port;
mod rights;
mod self_test;
mod service;

use super::arguments::ClientOptions;
use super::output::give;
use super::text;
use anyhow::Result;
use board::Examined;
use finding::{Finding, Level};
use meissner_api::Status;
use meissner_client::ClientError;
use meissner_client::access::CurrentUser;
use meissner_stream::device::Spec;
use serde::Serialize;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

#[derive(Debug, Serialize)]
struct Report {
    /// Whether the verdict is go.
    ok: bool,
    wake_up: host::WakeUp,
    /// Null if a daemon has the device, or there is none.
    device: Option<Examined>,
    findings: Vec<Finding>,
}

/// `asked`: which device; without it, the daemon's, else the first board. `self_test`: have the board test itself. `time`: how long to
/// measure wake-ups.
pub(super) fn run(
    asked: Option<Spec>,
    self_test: bool,
    time: Duration,
    options: &ClientOptions,
) -> Result<ExitCode> {
    let root = Path::new("/");
    let (realtime, wake_up) = host::measure(time);
    let status: Result<Status, ClientError> = options.client()?.get("/v1/status");
    let granted = status.as_ref().ok().and_then(|status| status.realtime);
    let units = service::units(root);
    let mut findings = Vec::from(rights::of_user(realtime, granted, units.is_installed()));
    findings.push(host::timers(&wake_up));
    findings.push(host::governor(root));
    findings.extend(service::findings(root, &units));
    let denied = daemon::is_denied(&status);
    // A refusal by the daemon already explains the groups.
    if !denied && let Some(me) = CurrentUser::look_up() {
        findings.extend(service::group(root, &units, &me));
    }
    let daemons = daemon::findings(root, &mut findings, asked.is_none(), status, &units);
    findings.extend(port::autosuspend(root));
    findings.extend(port::modem_manager(root));
    let device = match asked {
        None if daemons.is_some() => {
            if self_test {
                let advice = "stop the daemon (`systemctl stop meissner`, or end it) and run this again";
                findings.push(Finding::fail("self-test", "a daemon has the board", advice));
            }
            None
        }
        None => board::examine(root, &Spec::Board, self_test, &mut findings),
        Some(spec) => board::examine(root, &spec, self_test, &mut findings),
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
        (false, _) => "no go: see the lines marked FAIL",
    };
    give(options.output.json, &report, || format!("{}\n{verdict}", lines(&report.findings)))?;
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
