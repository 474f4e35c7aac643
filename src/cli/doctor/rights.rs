//! Checks the real-time rights of the user who runs the doctor: SCHED_FIFO and locked memory.

use crate::doctor::rights::limits;
use meissner_api::{Finding, Realtime};

/// The rights of this user. They matter only for a daemon that this user starts, so not if one runs or is `installed`.
pub(super) fn of_user(ours: Realtime, daemons: Option<Realtime>, installed: bool) -> [Finding; 2] {
    let finding = |what, ours, daemons| match (ours, daemons) {
        (true, _) => Finding::ok(what, "granted"),
        (false, Some(true)) => Finding::ok(what, "granted to the daemon, not to you"),
        (false, Some(false)) => Finding::ok(what, "not granted to you; only the daemon's rights count"),
        (false, None) if installed => {
            Finding::ok(what, "not granted to you; only the service's rights count")
        }
        (false, None) => {
            Finding::warn(what, "not granted: a daemon that you start may send strokes late", limits("$USER"))
        }
    };
    [
        finding("SCHED_FIFO", ours.fifo, daemons.map(|of| of.fifo)),
        finding("mlockall", ours.mlock, daemons.map(|of| of.mlock)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::fake;

    #[test]
    fn a_users_rights_matter_for_a_daemon_of_their_own() {
        let (none, all) = (Realtime::default(), Realtime { fifo: true, mlock: true });
        let lines = |ours, daemons, installed| of_user(ours, daemons, installed).each_ref().map(fake::line);
        assert_eq!(lines(all, None, false)[0], "Ok SCHED_FIFO: granted -> ");
        assert_eq!(lines(none, Some(all), true)[1], "Ok mlockall: granted to the daemon, not to you -> ");
        // The check `daemon rights` judges the daemon's.
        assert!(
            lines(none, Some(none), false)[0].starts_with("Ok SCHED_FIFO: not granted to you; only the d")
        );
        assert!(
            lines(none, None, true)[0].starts_with("Ok SCHED_FIFO: not granted to you; only the service's")
        );
        for line in lines(none, None, false) {
            assert!(
                line.starts_with("Warn ") && line.contains("rtprio 60\\n") && line.contains("log in again")
            );
        }
    }
}
