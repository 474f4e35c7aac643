//! Finds other programs that have a port open.
//!
//! It reads `/proc` with this user's rights, and opens no port.
//!
//! Invariant: a port counts as free only if every process could be checked.

use crate::doctor::port::{MODEM_MANAGER, Process, processes};
use meissner_api::Finding;
use std::fs;
use std::path::Path;

/// Whether a process has the port open; `None` if this user may not see.
fn has_open(root: &Path, pid: u32, port: &Path) -> Option<bool> {
    let open = fs::read_dir(root.join(format!("proc/{pid}/fd"))).ok()?;
    Some(open.flatten().any(|fd| fs::read_link(fd.path()).is_ok_and(|link| link == port)))
}

/// Finds other programs that have this port open. If one is `known` to have it open but is invisible to this user, the finding says
/// so.
pub(super) fn holders(root: &Path, path: &Path, known: bool) -> Option<Finding> {
    let port = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let ours = std::process::id();
    let (mut holders, mut hidden) = (Vec::new(), false);
    for process in processes(root).into_iter().filter(|process| process.pid != ours) {
        match has_open(root, process.pid, &port) {
            Some(true) => holders.push(process),
            Some(false) => {}
            None => hidden = true,
        }
    }
    let Some(Process { pid, name }) = holders.first() else {
        let found = format!("another program has {} open, and only root can see which", port.display());
        let ask = format!("run `sudo fuser -v {}`", port.display());
        return (known && hidden).then(|| Finding::warn("port", found, ask));
    };
    let names: Vec<_> = holders.iter().map(|Process { pid, name }| format!("{name} (pid {pid})")).collect();
    let found = format!("{} is open in {}", port.display(), names.join(", "));
    let advice = match name.as_str() {
        "meissner" => format!(
            "ask that daemon with `meissner status`; end it with `sudo systemctl stop meissner` or `kill {pid}`"
        ),
        MODEM_MANAGER => {
            "install the udev rules, which make it leave boards alone, and plug the board in again".to_owned()
        }
        _ => format!("end that program: `kill {pid}`"),
    };
    Some(Finding::warn("port", found, advice))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::fake;
    use std::os::unix::fs::symlink;
    use tempfile::TempDir;

    /// A machine on which these processes run, each with a port open.
    fn machine(running: &[(u32, &str, &str)]) -> TempDir {
        let dir = tempfile::tempdir().unwrap();
        for (pid, name, port) in running {
            fake::write(dir.path(), &format!("proc/{pid}/comm"), &format!("{name}\n"));
            let fds = dir.path().join(format!("proc/{pid}/fd"));
            fs::create_dir(&fds).unwrap();
            symlink("/dev/null", fds.join("0")).unwrap();
            symlink(port, fds.join("7")).unwrap();
        }
        fake::write(dir.path(), "proc/version", "no process");
        dir
    }

    #[test]
    fn programs_that_have_a_port_open_are_named() {
        let port = "/dev/no-such-port";
        let line = |running: &[_], known| {
            holders(machine(running).path(), Path::new(port), known).map(|finding| fake::line(&finding))
        };
        let ours = (std::process::id(), "meissner", port);
        assert_eq!(line(&[(7, "bash", "/dev/tty1"), ours], true), None);
        assert_eq!(
            line(&[(90, "minicom", port), (7, "bash", "/dev/tty1"), (412, "cat", port)], false).unwrap(),
            "Warn port: /dev/no-such-port is open in minicom (pid 90), cat (pid 412) -> end that program: `kill 90`"
        );
        let daemon = line(&[(812, "meissner", port)], true).unwrap();
        assert!(
            daemon.contains("-> ask that daemon with `meissner status`") && daemon.contains("`kill 812`"),
            "{daemon}"
        );
        assert!(line(&[(812, MODEM_MANAGER, port)], true).unwrap().contains("-> install the udev rules"));
    }

    #[test]
    fn a_port_that_could_not_be_checked_is_not_called_free() {
        let dir = machine(&[]);
        fake::write(dir.path(), "proc/1/comm", "init");
        let port = Path::new("/dev/no-such-port");
        assert_eq!(
            fake::line(&holders(dir.path(), port, true).unwrap()),
            "Warn port: another program has /dev/no-such-port open, and only root can see which -> run `sudo fuser -v \
             /dev/no-such-port`"
        );
        assert!(holders(dir.path(), port, false).is_none(), "it could be opened");
    }
}
