//! The doctor: what of this machine, its device and its daemon could keep a pattern from being played in time.
//!
//! It asks for the real-time means the streamer asks for, measures for a second how late timers wake a thread, and
//! looks at the device ([`crate::checkup`]): itself, or, where a daemon has it, by asking the daemon. It arms nothing
//! and moves nothing.
//!
//! Invariant: every finding that is not `ok` says what to do; it is a go only if none says `FAIL`.

mod board;

use super::{Plain, give, text};
use crate::api::Status;
use crate::checkup::{Drift, RoundTrip};
use crate::client::ClientError;
use crate::device::Spec;
use crate::record::DeviceInfo;
use crate::stream::Realtime;
use crate::units::HostInstant;
use anyhow::Result;
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};
use serde::Serialize;
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

/// How long and how often wake-ups are measured.
const WAKE_UPS: usize = 1000;
const PERIOD: Duration = Duration::from_millis(1);
/// A clock less certain than this makes `--at` worthless.
const CLOCK_US: f64 = 500.0;

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
}

/// How late timers woke a thread.
#[derive(Clone, Copy, Debug, Serialize)]
struct WakeUp {
    p50_us: f64,
    p99_us: f64,
    p999_us: f64,
    max_us: f64,
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
    round_trip: RoundTrip,
    throughput_bytes_per_s: Option<u32>,
    drift: Drift,
}

#[derive(Debug, Serialize)]
struct Report {
    /// Go.
    ok: bool,
    wake_up: WakeUp,
    /// Null if the device is a daemon's, or there is none.
    device: Option<Examined>,
    findings: Vec<Finding>,
}

/// `asked`: which device; without it, what a daemon has, else the first board.
pub(super) fn run(asked: Option<Spec>, plain: &Plain) -> Result<ExitCode> {
    // On a thread of its own, whose priority goes with it.
    let measured = thread::spawn(|| (Realtime::request(), measure())).join();
    let (realtime, wake_up) = measured.unwrap_or((Realtime::default(), WakeUp::NONE));
    let mut findings = Vec::from(rights(realtime));
    findings.push(timers(&wake_up));
    let status = plain.client()?.get("/v1/status");
    let daemons = daemon(&mut findings, asked.is_none(), status);
    let device = match asked {
        None if daemons.is_some() => None,
        None => board::examine(&Spec::Board, &mut findings),
        Some(spec) => board::examine(&spec, &mut findings),
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

fn rights(realtime: Realtime) -> [Finding; 2] {
    let granted = |granted| if granted { (Level::Ok, "granted") } else { (Level::Warn, "not granted") };
    let (level, found) = granted(realtime.fifo);
    let advice =
        "give the daemon LimitRTPRIO=60 (systemd) or an rtprio limit (limits.conf); strokes may come late";
    let fifo = Finding::new("SCHED_FIFO", level, found, advice);
    let (level, found) = granted(realtime.mlock);
    let advice = "give the daemon LimitMEMLOCK=infinity (systemd) or a memlock limit (limits.conf)";
    [fifo, Finding::new("mlockall", level, found, advice)]
}

impl WakeUp {
    const NONE: Self = Self { p50_us: f64::NAN, p99_us: f64::NAN, p999_us: f64::NAN, max_us: f64::NAN };
}

fn measure() -> WakeUp {
    let begun = HostInstant::now();
    let mut late_us: Vec<f64> = (1..=WAKE_UPS)
        .filter_map(|count| {
            let wanted = begun + PERIOD * u32::try_from(count).ok()?;
            sleep_until(wanted);
            Some(HostInstant::now().since(wanted).as_secs_f64() * 1e6)
        })
        .collect();
    late_us.sort_by(f64::total_cmp);
    let at = |per_mille: usize| {
        late_us.get((late_us.len() * per_mille / 1000).min(late_us.len().saturating_sub(1)))
    };
    let at = |per_mille| at(per_mille).copied().unwrap_or(f64::NAN);
    WakeUp { p50_us: at(500), p99_us: at(990), p999_us: at(999), max_us: at(1000) }
}

fn sleep_until(wanted: HostInstant) {
    let seconds = (wanted.as_ns() / 1_000_000_000).cast_signed();
    let time = Timespec { tv_sec: seconds, tv_nsec: (wanted.as_ns() % 1_000_000_000).cast_signed() };
    // Interrupted by a signal, it measures a wake-up that was early: 0.
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &time);
}

fn timers(wake_up: &WakeUp) -> Finding {
    let WakeUp { p50_us, p99_us, p999_us, max_us } = wake_up;
    let found =
        format!("late by {p50_us:.0} us (p50), {p99_us:.0} (p99), {p999_us:.0} (p99.9), {max_us:.0} (max)");
    // Half the default lead: beyond it, a second stall in a row is late.
    let level = if *max_us < 50_000.0 { Level::Ok } else { Level::Warn };
    Finding::new(
        "timers",
        level,
        found,
        "raise lead_ms above twice the worst, or use a machine with less beside it",
    )
}

/// What a daemon says of itself and, if nobody asked for another, of its device; its status, if the device is its to
/// judge.
fn daemon(findings: &mut Vec<Finding>, judged: bool, status: Result<Status, ClientError>) -> Option<Status> {
    let status = match status {
        Ok(status) => status,
        Err(ClientError::NoDaemon { place, .. }) => {
            let found = format!("none answers at {}", place.socket.display());
            let advice = "to play, start one with `meissner daemon`, or name its socket with --socket";
            findings.push(Finding::new("daemon", Level::Warn, found, advice));
            return None;
        }
        Err(error) => {
            findings.push(Finding::new("daemon", Level::Fail, error.to_string(), "see its log"));
            return None;
        }
    };
    let holds = status.device.as_ref().map_or_else(String::new, |device| format!(", has {}", device.kind));
    let found = format!("version {}, pid {}{holds}", status.version, status.pid);
    let same = status.version == env!("CARGO_PKG_VERSION");
    let level = if same { Level::Ok } else { Level::Warn };
    findings.push(Finding::new("daemon", level, found, "restart it: this program has another version"));
    if !judged {
        return None;
    }
    match &status.device {
        Some(device) => held(findings, &status, device),
        None => {
            let found = match &status.missing {
                Some(missing) => format!("has no device: {missing}"),
                None => format!("has no device yet: `{}` was asked for", status.wanted),
            };
            let advice = "it looks again by itself; for another device restart it with --device";
            findings.push(Finding::new("daemon", Level::Fail, found, advice));
        }
    }
    Some(status)
}

/// The daemon's device, by what the daemon says.
fn held(findings: &mut Vec<Finding>, status: &Status, device: &DeviceInfo) {
    let found = format!("{}, firmware {}", device.kind, device.firmware);
    let level = if device.simulated { Level::Warn } else { Level::Ok };
    findings.push(Finding::new(
        "device",
        level,
        found,
        "it is simulated, no real pin moves: plug the board in and restart the daemon, or name one with `daemon \
         --device`",
    ));
    let state = format!("{} ({}), position {}", status.state, status.cause, status.position);
    findings.push(match (status.state.as_str(), status.position.as_str()) {
        ("faulted", _) => Finding::new(
            "state",
            Level::Fail,
            state,
            "find out why, then `meissner reset` and `meissner arm`",
        ),
        ("disarmed", "unknown") => Finding::new(
            "state",
            Level::Warn,
            state,
            "see that all pins are at rest, then `meissner arm --assume-rest`",
        ),
        ("disarmed", _) => Finding::new("state", Level::Warn, state, "`meissner arm` before you play"),
        _ => Finding::new("state", Level::Ok, state, ""),
    });
    let uncertainty_us = status.clock_uncertainty_us.unwrap_or(f64::INFINITY);
    let level = if uncertainty_us < CLOCK_US { Level::Ok } else { Level::Warn };
    let found = format!("known to {uncertainty_us:.1} us");
    findings.push(Finding::new(
        "clock",
        level,
        found,
        "onsets asked for with --at are no better; see the cable and the load",
    ));
    if let Some(bytes) = status.line_bytes_per_s {
        findings.push(board::line(bytes));
    }
    findings.extend(board::telemetry(device.telemetry));
}
