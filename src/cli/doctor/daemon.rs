//! Checks a daemon: whether it answers, whether it has its real-time rights, and what it reports about its device.
//!
//! The doctor asks the daemon about its device, because a session of its own would make the device return the pins.
//!
//! Invariant: a daemon that does not answer, or has no device, is a finding and no error.

use super::board;
use super::finding::{Finding, Level};
use super::rights::{self, Limits};
use super::service::Units;
use meissner_api::{DeviceInfo, NetworkStatus, Status};
use meissner_client::ClientError;
use std::net::SocketAddr;
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
    findings.push(network(status.network.as_ref()));
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

/// Who can reach the daemon.
fn network(status: Option<&NetworkStatus>) -> Finding {
    const WHAT: &str = "network";
    let Some(status) = status else {
        return Finding::ok(WHAT, "nothing listens: only users who may use the socket reach the daemon");
    };
    let NetworkStatus { address, loopback_without_token, observe_tokens, operate_tokens, denied, problem } =
        status;
    if let Some(problem) = problem {
        return Finding::warn(
            WHAT,
            problem.clone(),
            "the page and clients over the network cannot connect; the socket works",
        );
    }
    let is_local = address.parse().is_ok_and(|address: SocketAddr| address.ip().is_loopback());
    let tokens = format!("{operate_tokens} tokens to operate and {observe_tokens} to observe are valid");
    let local = if *loopback_without_token { "every user of this machine may operate, " } else { "" };
    let far = if is_local { "" } else { "other machines need a token, " };
    let found = format!("http://{address}: {local}{far}{tokens}; {denied} requests were refused");
    match (is_local, loopback_without_token) {
        (false, _) => Finding::warn(
            WHAT,
            found,
            "tokens travel unencrypted: let only machines reach it that you trust, or use a proxy with TLS or ssh: docs/how-to/network.md",
        ),
        (true, true) => Finding::warn(
            WHAT,
            found,
            "if others use this machine, set `listen_token = \"always\"` in the configuration, and restart the daemon",
        ),
        (true, false) => Finding::ok(WHAT, found),
    }
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

    #[test]
    fn the_doctor_says_who_can_reach_the_daemon() {
        let line = |address: &str, loopback_without_token| {
            fake::line(&network(Some(&NetworkStatus {
                address: address.to_owned(),
                loopback_without_token,
                observe_tokens: 1,
                operate_tokens: 2,
                denied: 3,
                problem: None,
            })))
        };
        assert_eq!(fake::line(&network(None)).split(':').next(), Some("Ok network"));
        let local = line("127.0.0.1:8765", true);
        assert!(
            local.starts_with(
                "Warn network: http://127.0.0.1:8765: every user of this machine may operate, 2 tokens"
            ),
            "{local}"
        );
        assert!(local.contains("listen_token = \"always\""), "{local}");
        assert!(
            line("[::1]:8765", false)
                .starts_with("Ok network: http://[::1]:8765: 2 tokens to operate and 1 to observe")
        );
        let far = line("0.0.0.0:8765", false);
        assert!(
            far.starts_with("Warn ")
                && far.contains("other machines need a token")
                && far.contains("unencrypted"),
            "{far}"
        );
    }

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
