//! Checks a daemon: whether it answers, whether it has its real-time rights, and what it reports about its device.
//!
//! The doctor asks the daemon about its device, because a session of its own would make the device return the pins.
//!
//! Invariant: a daemon that does not answer, or has no device, is a finding and no error.

use super::board;
use super::finding::{Finding, Level};
use super::rights::{self, Limits};
use super::service::Units;
use meissner_api::{DeviceInfo, Status};
use meissner_client::ClientError;
use std::path::Path;

/// A clock that is less certain makes `--at` useless.
const CLOCK_US: f64 = 500.0;

/// Whether a daemon is there and refuses this user.
pub(super) const fn is_denied(status: &Result<Status, ClientError>) -> bool {
    matches!(status, Err(ClientError::Denied { .. }))
}

/// Adds the findings about a daemon and, unless the user asked for another device, about its device. Returns the daemon's
/// status if its device was judged.
pub(super) fn findings(
    root: &Path,
    findings: &mut Vec<Finding>,
    judged: bool,
    status: Result<Status, ClientError>,
    units: &Units,
) -> Option<Status> {
    let status = match status {
        Ok(status) => status,
        Err(ClientError::NoDaemon { endpoint, .. }) => {
            let advice = format!("to play, {}, or name its socket with --socket", endpoint.how_to_start());
            findings.push(Finding::warn("daemon", format!("no daemon answers at {endpoint}"), advice));
            return None;
        }
        Err(ClientError::Denied { socket, found, advice }) => {
            let found = format!("a daemon listens at {}, but {found}", socket.display());
            findings.push(Finding::fail("daemon", found, advice));
            return None;
        }
        Err(error) => {
            findings.push(Finding::fail("daemon", error.to_string(), "read the daemon's log"));
            return None;
        }
    };
    let holds = status.device.as_ref().map_or_else(String::new, |device| format!(", has {}", device.kind));
    let found = format!("version {}, pid {}, at {}{holds}", status.version, status.pid, status.socket);
    let same = status.version == env!("CARGO_PKG_VERSION");
    findings.push(Finding::check(
        "daemon",
        same,
        found,
        "restart the daemon: this program has another version",
    ));
    findings.extend(rights::of_daemon(status.realtime, Limits::of(root, status.pid), units.runs(status.pid)));
    if let Some(problem) = &status.logbook_problem {
        let advice =
            "free space there, or let the daemon write there: see deploy/README.md, \"Configuration\"";
        findings.push(Finding::warn("logbook", problem.clone(), advice));
    }
    if !judged {
        return None;
    }
    match &status.device {
        Some(device) => held(findings, &status, device),
        None => {
            let found = match &status.no_device_reason {
                Some(missing) => format!("the daemon has no device: {missing}"),
                None => format!("the daemon has no device yet: it looks for `{}`", status.requested_device),
            };
            let advice = "the daemon keeps looking; for another device set `device` in its configuration, or restart it with --device";
            findings.push(Finding::fail("daemon", found, advice));
        }
    }
    Some(status)
}

/// Judges the daemon's device by what the daemon reports.
fn held(findings: &mut Vec<Finding>, status: &Status, device: &DeviceInfo) {
    let found = format!("{}, firmware {}", device.kind, device.firmware);
    let instead = "plug a board in, which replaces it until a client has armed; after that, or for another `device`, restart the \
                   daemon";
    findings.push(board::device(device.simulated, found, instead));
    let state = format!("{} ({}), position {}", status.state, status.cause, status.position);
    let (level, advice) = match (status.state.as_str(), status.position.as_str()) {
        ("faulted", _) => (Level::Fail, "find the cause, then `meissner reset` and `meissner arm`"),
        ("disarmed", "unknown") => {
            (Level::Warn, "check that all pins are at rest, then `meissner arm --assume-rest`")
        }
        ("disarmed", _) => (Level::Warn, "`meissner arm` before you play"),
        _ => (Level::Ok, ""),
    };
    findings.push(Finding::new("state", level, state, advice));
    let uncertainty_us = status.clock_uncertainty_us.unwrap_or(f64::INFINITY);
    let found = format!("synchronised to +-{uncertainty_us:.1} us");
    let advice = "onsets requested with --at are no more exact: check the cable and the machine's load";
    findings.push(Finding::check("clock", uncertainty_us < CLOCK_US, found, advice));
    if let Some(bytes) = status.line_bytes_per_s {
        findings.push(board::line(bytes));
    }
    findings.extend(board::telemetry(device.telemetry));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::doctor::finding::fake;
    use std::path::PathBuf;

    fn finding(error: ClientError) -> String {
        let mut found = Vec::new();
        let status = Err(error);
        let denied = is_denied(&status);
        assert!(findings(Path::new("/"), &mut found, true, status, &Units::default()).is_none());
        assert_eq!(denied, found[0].level == Level::Fail);
        fake::line(&found[0])
    }

    #[test]
    fn a_daemon_that_does_not_answer_is_a_finding() {
        let endpoint = meissner_client::Endpoint {
            socket: PathBuf::from("/a"),
            fallback: Some(PathBuf::from("/b")),
            service_installed: true,
        };
        let source = std::io::ErrorKind::NotFound.into();
        assert_eq!(
            finding(ClientError::NoDaemon { endpoint, source }),
            "Warn daemon: no daemon answers at /a, nor at /b -> to play, `sudo systemctl start meissner`, or start one with \
             `meissner daemon`, or name its socket with --socket"
        );
        let (found, advice) = ("you are not in it".to_owned(), "`join`".to_owned());
        assert_eq!(
            finding(ClientError::Denied { socket: "/a".into(), found, advice }),
            "Fail daemon: a daemon listens at /a, but you are not in it -> `join`"
        );
    }
}
