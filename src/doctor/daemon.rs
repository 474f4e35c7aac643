//! Checks a daemon by its status: its version, its real-time rights, its session record, and the clients that can reach it.

use super::rights::{self, Limits, SLOW_ESTOP};
use super::service::Units;
use meissner_api::{Finding, NetworkStatus, Realtime, Status};
use std::net::SocketAddr;
use std::path::Path;

/// The findings about the daemon with this status.
pub(crate) fn findings(root: &Path, status: &Status, units: &Units) -> Vec<Finding> {
    let holds = status.device.as_ref().map_or_else(String::new, |device| format!(", has {}", device.kind));
    let found = format!(
        "version {}, pid {}, at {}{holds}",
        status.daemon.version, status.daemon.pid, status.daemon.socket
    );
    let same = status.daemon.version == env!("CARGO_PKG_VERSION");
    let advice = "restart the daemon: this program has another version";
    let mut findings = vec![Finding::check("daemon", same, found, advice)];
    findings.push(rights::of_daemon(
        status.daemon.realtime,
        Limits::of(root, status.daemon.pid),
        units.runs(status.daemon.pid),
    ));
    findings.extend(estop(status.daemon.realtime));
    if let Some(problem) = &status.daemon.logbook_problem {
        let advice = "free space there, let the daemon write there, or set `logbook_dir` to a folder of its own: see docs/lab-pc.md, \"Configuration\"; `meissner session list` shows \
             what is missing";
        findings.push(Finding::warn("logbook", problem.clone(), advice));
    } else if let lost @ 1.. = status.daemon.logbook_lost {
        let found = format!("the session record has lost {lost} entries since the daemon started");
        let advice = "see which sessions lack plays: `meissner session list`";
        findings.push(Finding::warn("logbook", found, advice));
    }
    findings.push(network(status.daemon.network.as_ref()));
    findings
}

/// Says that an emergency stop may be late, if the daemon has no real-time rights.
fn estop(has: Realtime) -> Option<Finding> {
    let advice =
        "give the daemon SCHED_FIFO, as \"daemon rights\" says, and keep the supply switch within reach";
    (!has.fifo).then(|| Finding::warn("emergency stop", SLOW_ESTOP, advice))
}

/// The finding about the network clients that can reach the daemon.
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
            "tokens travel unencrypted: let only machines reach it that you trust, or use a proxy with TLS or ssh: docs/lab-pc.md",
        ),
        (true, true) => Finding::warn(
            WHAT,
            found,
            "if others use this machine, set `listen_token = \"always\"` in the configuration, and restart the daemon",
        ),
        (true, false) => Finding::ok(WHAT, found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::fake;

    #[test]
    fn the_doctor_says_how_late_an_emergency_stop_may_be_without_real_time_rights() {
        let of = |fifo| estop(Realtime { fifo, mlock: true });
        assert_eq!(of(true), None);
        let line = fake::line(&of(false).unwrap());
        assert!(
            line.starts_with("Warn emergency stop: without SCHED_FIFO") && line.contains("110 ms"),
            "{line}"
        );
    }

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
}
