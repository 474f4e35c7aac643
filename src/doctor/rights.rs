//! Checks a daemon's real-time rights: SCHED_FIFO and locked memory.
//!
//! Its limits come from the kernel; whether they were enough comes from the daemon itself.

use meissner_api::{Finding, Realtime};
use meissner_stream::device::priority::FIFO_PRIORITY;
use std::fs;
use std::path::Path;

/// The measured delay of an emergency stop in a daemon without SCHED_FIFO: docs/dev/measurements.md, "E-stop under load".
pub(crate) const SLOW_ESTOP: &str = "without SCHED_FIFO an emergency stop waits for other programs: under load its p99 was 27 ms and the \
                                     worst 110 ms; with it p99 stayed below 1.2 ms";

/// The configuration that gives a user real-time rights without a service manager. `user`: a name, or a shell variable for it.
pub(crate) fn limits(user: &str) -> String {
    format!(
        "`printf '%s - rtprio 60\\n%s - memlock unlimited\\n' {user} {user} | sudo tee \
         /etc/security/limits.d/90-meissner.conf`, then log in again"
    )
}

/// A process's soft limits, as the kernel writes them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Limits {
    rtprio: String,
    memlock: String,
}

impl Limits {
    /// The limits of this process, if this user may read them.
    pub(super) fn of(root: &Path, pid: u32) -> Option<Self> {
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

    /// A lower limit suffices only for a while, because memory grows.
    fn mlock(&self) -> bool {
        self.memlock == "unlimited"
    }
}

/// The rights of a daemon.
pub(super) fn of_daemon(has: Realtime, limits: Option<Limits>, service: bool) -> Finding {
    const WHAT: &str = "daemon rights";
    let may = limits.as_ref().map(|limits| Realtime { fifo: limits.fifo(), mlock: limits.mlock() });
    if has.fifo && has.mlock {
        return Finding::ok(WHAT, "the daemon has SCHED_FIFO and locked memory");
    }
    let missing: Vec<&str> = [(has.fifo, "SCHED_FIFO"), (has.mlock, "locked memory")]
        .into_iter()
        .filter_map(|(has, name)| (!has).then_some(name))
        .collect();
    let allowed = limits.as_ref().map_or_else(String::new, |limits| {
        format!(" (its limits: rtprio {}, memlock {})", limits.rtprio, limits.memlock)
    });
    let found = format!("the daemon lacks {}{allowed}: strokes may come late", missing.join(" and "));
    // If the limits allow a right that the daemon lacks, something else refuses it.
    let refused = may.is_some_and(|may| (may.fifo || has.fifo) && (may.mlock || has.mlock));
    let advice = match (service, refused) {
        (true, false) => {
            "run `systemctl show meissner -p LimitRTPRIO,LimitMEMLOCK`: if it shows 60 and infinity, this system does not \
             grant them (a container?); else run `sudo systemctl edit meissner`, write [Service], LimitRTPRIO=60 and \
             LimitMEMLOCK=infinity on lines of their own, then `sudo systemctl restart meissner`"
                .to_owned()
        }
        (true, true) => {
            "its limits would allow it: check `systemctl show meissner -p RestrictRealtime,SystemCallFilter`, and whether \
             this is a container"
                .to_owned()
        }
        (false, false) => {
            let limits = self::limits("USER");
            format!("with the daemon's user for USER: {limits}, and start the daemon again")
        }
        (false, true) => "its limits would allow it: start the daemon again, unless this is a container".to_owned(),
    };
    Finding::warn(WHAT, found, advice)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::fake;

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
    fn a_daemon_without_rights_gets_advice() {
        let line = |has, limits, service| fake::line(&of_daemon(has, limits, service));
        let good = "Ok daemon rights: the daemon has SCHED_FIFO and locked memory -> ";
        assert_eq!(line(ALL, None, true), good);
        let bad = line(NONE, limits("0", "8388608"), true);
        assert!(
            bad.starts_with(
                "Warn daemon rights: the daemon lacks SCHED_FIFO and locked memory (its limits: rtprio 0, memlock \
                 8388608): strokes may come late -> "
            ) && bad.contains("`sudo systemctl edit meissner`"),
            "{bad}"
        );
        let half = line(Realtime { fifo: true, mlock: false }, limits("60", "8388608"), true);
        assert!(
            half.contains("the daemon lacks locked memory (") && half.contains("LimitMEMLOCK=infinity"),
            "{half}"
        );
        let own = line(NONE, limits("0", "8388608"), false);
        assert!(own.contains("limits.d") && !own.contains("systemctl"), "{own}");
        let refused = line(NONE, limits("60", "unlimited"), true);
        assert!(refused.contains("-p RestrictRealtime"), "{refused}");
        assert!(line(NONE, limits("60", "unlimited"), false).contains("start the daemon again, unless"));
    }
}
