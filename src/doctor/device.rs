//! Checks the device of a daemon from the daemon's status. The checks that need no status are also used for a device without a
//! daemon.
//!
//! The limits are here, each with its reason.

use meissner_api::{DeviceInfo, Finding, Level, Status};

/// On a line that carries less, the daemon refuses some of the shipped patterns with their corrections.
const ALL_BYTES_PER_S: u32 = 60_000;
/// Below this not even a few pins can be driven.
const ANY_BYTES_PER_S: u32 = 2_000;
/// A clock that is less certain makes `--at` useless.
const CLOCK_US: f64 = 500.0;
/// The finding for a device without telemetry.
pub(crate) const NO_TELEMETRY: &str = "none: bursts are not corrected, pins drift";
/// What users of the simulated array with telemetry should know.
pub(crate) const ON_NO_BOARD: &str =
    "simulated: no board has it; pilot a study with `--device mock:board`, on which pins drift as on a board";
/// The advice without telemetry.
pub(crate) const SHORT_PLAYS: &str = "keep plays short";

/// The findings about the daemon's device.
pub(crate) fn findings(status: &Status) -> Vec<Finding> {
    let Some(device) = &status.device else {
        let found = match &status.link.missing {
            Some(missing) => format!("the daemon has no device: {missing}"),
            None => format!("the daemon has no device yet: it looks for `{}`", status.link.wanted),
        };
        let advice = "the daemon keeps looking; for another device set `device` in its configuration, or restart it with --device";
        return vec![Finding::fail("daemon", found, advice)];
    };
    let mut findings = held(status, device);
    findings.extend(status.link.bytes_per_s.map(line));
    findings.extend(telemetry(device.telemetry));
    findings.push(trigger_input(device.trigger_input));
    findings
}

/// Findings about a connected device: its identity, its state, its clock.
fn held(status: &Status, device: &DeviceInfo) -> Vec<Finding> {
    let found = format!("{}, firmware {}", device.kind, device.firmware);
    let instead = "plug a board in, which replaces it until a client has armed; after that, or for another `device`, restart the \
                   daemon";
    let simulated = simulated(device.simulated, found, instead);
    let state = format!("{} ({}), position {}", status.state, status.cause, status.position);
    let (level, advice) = match (status.state.as_str(), status.position.as_str()) {
        ("faulted", _) => (Level::Fail, "find the cause, then `meissner reset` and `meissner arm`"),
        ("disarmed", "unknown") => {
            (Level::Warn, "check that all pins are at rest, then `meissner arm --assume-rest`")
        }
        ("disarmed", _) => (Level::Warn, "`meissner arm` before you play"),
        _ => (Level::Ok, ""),
    };
    let state = Finding::new("state", level, state, advice);
    let uncertainty_us = status.clock.map_or(f64::INFINITY, |clock| clock.uncertainty_us);
    let found = format!("synchronised to +-{uncertainty_us:.1} us");
    let advice = "onsets requested with --at are no more exact: check the cable and the machine's load";
    let clock = Finding::check("clock", uncertainty_us < CLOCK_US, found, advice);
    vec![simulated, state, clock]
}

/// The finding whether the device is simulated; `instead` says how to use a board.
pub(crate) fn simulated(simulated: bool, found: String, instead: &str) -> Finding {
    Finding::check("device", !simulated, found, format!("it is simulated, no real pin moves: {instead}"))
}

/// A finding if the device sends no telemetry.
pub(crate) fn telemetry(there: bool) -> Option<Finding> {
    (!there).then(|| Finding::warn("telemetry", NO_TELEMETRY, SHORT_PLAYS))
}

/// Whether the device has a trigger input. Few experiments need one.
pub(crate) fn trigger_input(there: bool) -> Finding {
    Finding::new("trigger input", Level::Ok, if there { "yes" } else { "none" }.to_owned(), "")
}

/// Whether the line carries enough.
pub(crate) fn line(bytes_per_s: u32) -> Finding {
    let level = match bytes_per_s {
        rate if rate < ANY_BYTES_PER_S => Level::Fail,
        rate if rate < ALL_BYTES_PER_S => Level::Warn,
        _ => Level::Ok,
    };
    let found = format!("carries {:.1} kB/s", f64::from(bytes_per_s) / 1000.0);
    Finding::new("line", level, found, "the daemon refuses plays that need more: use USB, or a faster UART")
}
