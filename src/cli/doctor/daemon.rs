//! The doctor's look at a daemon: that it answers, that it has its real-time rights, and what it says of its device.
//!
//! The device is the daemon's: it is asked, since a session of the doctor's own would return the pins. Its limits are the
//! kernel's word; whether they were enough is its own.
//!
//! Invariant: a daemon that does not answer, or has no device, is a finding and no error.

use super::service::Units;
use super::{Finding, Level, board, host};
use meissner_api::DeviceInfo;
use meissner_api::Realtime;
use meissner_api::Status;
use meissner_client::ClientError;
use meissner_stream::device::priority::FIFO_PRIORITY;
use std::fs;
use std::path::Path;

/// A clock less certain than this makes `--at` worthless.
const CLOCK_US: f64 = 500.0;

/// Whether it is there, and does not let us in.
pub(super) const fn is_denied(status: &Result<Status, ClientError>) -> bool {
    matches!(status, Err(ClientError::Denied { .. }))
}

/// What the kernel allows a process; soft limits, in its own words.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Limits {
    rtprio: String,
    memlock: String,
}

impl Limits {
    /// Of this process, if it may be known.
    fn of(root: &Path, pid: u32) -> Option<Self> {
        let text = fs::read_to_string(root.join(format!("proc/{pid}/limits"))).ok()?;
        let soft = |name| {
            let line = text.lines().find_map(|line| line.strip_prefix(name))?;
            Some(line.split_whitespace().next()?.to_owned())
        };
        Some(Self { rtprio: soft("Max realtime priority")?, memlock: soft("Max locked memory")? })
    }

    fn fifo(&self) -> bool {
        self.rtprio == "unlimited"
            || self.rtprio.parse().is_ok_and(|limit: u32| limit >= FIFO_PRIORITY.into())
    }

    /// Less is enough only for a while: memory grows.
    fn mlock(&self) -> bool {
        self.memlock == "unlimited"
    }
}

/// A daemon's real-time rights; `None` if neither it nor the kernel tells.
fn rights(realtime: Option<Realtime>, limits: Option<Limits>, service: bool) -> Option<Finding> {
    const WHAT: &str = "daemon rights";
    let may = limits.as_ref().map(|limits| Realtime { fifo: limits.fifo(), mlock: limits.mlock() });
    let has = realtime.or(may)?;
    if has.fifo && has.mlock {
        return Some(Finding::ok(WHAT, "it has SCHED_FIFO and locked memory"));
    }
    let missing: Vec<&str> = [(has.fifo, "SCHED_FIFO"), (has.mlock, "locked memory")]
        .into_iter()
        .filter_map(|(has, name)| (!has).then_some(name))
        .collect();
    let allowed = limits.as_ref().map_or_else(String::new, |limits| {
        format!(" (its limits: rtprio {}, memlock {})", limits.rtprio, limits.memlock)
    });
    let found = format!("it has no {}{allowed}: strokes may come late", missing.join(" and no "));
    // What the limits allow and it has not got, somebody else refuses.
    let refused = may.is_some_and(|may| (may.fifo || has.fifo) && (may.mlock || has.mlock));
    let advice = match (service, refused) {
        (true, false) => {
            "if `systemctl show meissner -p LimitRTPRIO,LimitMEMLOCK` says 60 and infinity, this system does not grant them \
             (a container?); else `sudo systemctl edit meissner`: write [Service], LimitRTPRIO=60 and LimitMEMLOCK=infinity on \
             lines of their own, then `sudo systemctl restart meissner`"
                .to_owned()
        }
        (true, true) => {
            "its limits would allow it: see `systemctl show meissner -p RestrictRealtime,SystemCallFilter`, \
                         and whether this is a container"
                .to_owned()
        }
        (false, false) => format!("{}, and start the daemon again", host::LIMITS),
        (false, true) => "its limits would allow it: start it again, unless this is a container".to_owned(),
    };
    Some(Finding::warn(WHAT, found, advice))
}

/// What there is to say of a daemon and, if nobody asked for another, of its device; its status, if the device is its to
/// judge.
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
            let advice = format!("to play, {}, or name its socket with --socket", endpoint.start());
            findings.push(Finding::warn("daemon", format!("none answers at {endpoint}"), advice));
            return None;
        }
        Err(ClientError::Denied { socket, found, advice }) => {
            let found = format!("one is at {}, but {found}", socket.display());
            findings.push(Finding::fail("daemon", found, advice));
            return None;
        }
        Err(error) => {
            findings.push(Finding::new("daemon", Level::Fail, error.to_string(), "see its log"));
            return None;
        }
    };
    let holds = status.device.as_ref().map_or_else(String::new, |device| format!(", has {}", device.kind));
    let found = format!("version {}, pid {}, at {}{holds}", status.version, status.pid, status.socket);
    let same = status.version == env!("CARGO_PKG_VERSION");
    let level = if same { Level::Ok } else { Level::Warn };
    findings.push(Finding::new("daemon", level, found, "restart it: this program has another version"));
    findings.extend(rights(status.realtime, Limits::of(root, status.pid), units.runs(status.pid)));
    if let Some(problem) = &status.logbook_problem {
        let advice =
            "make room there, or let the daemon write there: see deploy/README.md, \"Configuration\"";
        findings.push(Finding::warn("logbook", problem.clone(), advice));
    }
    if !judged {
        return None;
    }
    match &status.device {
        Some(device) => held(findings, &status, device),
        None => {
            let found = match &status.no_device_reason {
                Some(missing) => format!("has no device: {missing}"),
                None => format!("has no device yet: `{}` was asked for", status.requested_device),
            };
            let advice = "it looks again by itself; for another one set `device` in its configuration, or restart it with --device";
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
        "it is simulated, no real pin moves: plug a board in, which takes its endpoint until somebody has armed; after that, or \
         for another `device`, restart the daemon",
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

#[cfg(test)]
mod tests {
    use super::super::fake;
    use super::*;
    use std::path::PathBuf;

    const ALL: Realtime = Realtime { fifo: true, mlock: true };
    const NONE: Realtime = Realtime { fifo: false, mlock: false };

    fn limits(rtprio: &str, memlock: &str) -> Option<Limits> {
        let dir = tempfile::tempdir().unwrap();
        let text = format!(
            "Limit                     Soft Limit           Hard Limit           Units     \n\
             Max open files            1024                 524288               files     \n\
             Max locked memory         {memlock:<20} unlimited            bytes     \n\
             Max realtime priority     {rtprio:<20} 99                              \n"
        );
        fake::write(dir.path(), "proc/812/limits", &text);
        assert_eq!(Limits::of(dir.path(), 813), None);
        Limits::of(dir.path(), 812)
    }

    #[test]
    fn a_daemon_without_rights_is_told_of_with_what_gives_them() {
        let line = |has, limits, service| rights(has, limits, service).map(|finding| fake::line(&finding));
        let good = Some("Ok daemon rights: it has SCHED_FIFO and locked memory -> ".to_owned());
        assert_eq!(line(Some(ALL), None, true), good);
        assert_eq!(line(None, limits("60", "unlimited"), true), good, "an older one, by its limits");
        assert_eq!(line(None, None, true), None);
        let bad = line(Some(NONE), limits("0", "8388608"), true).unwrap();
        assert!(
            bad.starts_with(
                "Warn daemon rights: it has no SCHED_FIFO and no locked memory (its limits: rtprio 0, memlock \
                 8388608): strokes may come late -> "
            ) && bad.contains("`sudo systemctl edit meissner`"),
            "{bad}"
        );
        let half = line(Some(Realtime { fifo: true, mlock: false }), limits("60", "8388608"), true).unwrap();
        assert!(
            half.contains("it has no locked memory (") && half.contains("LimitMEMLOCK=infinity"),
            "{half}"
        );
        let own = line(Some(NONE), limits("0", "8388608"), false).unwrap();
        assert!(own.contains("limits.d") && !own.contains("systemctl"), "{own}");
        let refused = line(Some(NONE), limits("60", "unlimited"), true).unwrap();
        assert!(refused.contains("-p RestrictRealtime"), "{refused}");
        assert!(line(Some(NONE), limits("60", "unlimited"), false).unwrap().contains("start it again"));
    }

    fn told(error: ClientError) -> String {
        let mut told = Vec::new();
        let status = Err(error);
        let denied = is_denied(&status);
        assert!(findings(Path::new("/"), &mut told, true, status, &Units::default()).is_none());
        assert_eq!(denied, told[0].level == Level::Fail);
        fake::line(&told[0])
    }

    #[test]
    fn a_daemon_that_cannot_be_asked_is_a_finding() {
        let endpoint = meissner_client::Endpoint {
            socket: PathBuf::from("/a"),
            other: Some(PathBuf::from("/b")),
            service: true,
        };
        let source = std::io::ErrorKind::NotFound.into();
        assert_eq!(
            told(ClientError::NoDaemon { endpoint, source }),
            "Warn daemon: none answers at /a, nor at /b -> to play, `sudo systemctl start meissner`, or start one with \
             `meissner daemon`, or name its socket with --socket"
        );
        let (found, advice) = ("you are not in it".to_owned(), "`join`".to_owned());
        assert_eq!(
            told(ClientError::Denied { socket: "/a".into(), found, advice }),
            "Fail daemon: one is at /a, but you are not in it -> `join`"
        );
    }
}
