//! Checks the boards' ports: which programs have one open, and what the system does to boards by itself.
//!
//! It reads `/proc` and `/sys`, as far as this user may, and opens no port. It does not check hubs: a hub sleeps only when
//! all devices behind it sleep, so a board that stays awake keeps its hubs awake.
//!
//! Invariant: a port is called free only if every process could be checked.

use super::finding::Finding;
use super::service;
use meissner_stream::device::find::BoardQuery;
use std::fs;
use std::path::{Path, PathBuf};

const USB: &str = "sys/bus/usb/devices";
const MODEM_MANAGER: &str = "ModemManager";

/// A process by number and name.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Process {
    pid: u32,
    name: String,
}

fn processes(root: &Path) -> Vec<Process> {
    let entries = fs::read_dir(root.join("proc")).into_iter().flatten().flatten();
    let process = |entry: fs::DirEntry| {
        let pid = entry.file_name().to_str()?.parse().ok()?;
        let name = fs::read_to_string(entry.path().join("comm")).ok()?;
        Some(Process { pid, name: name.trim_end().to_owned() })
    };
    let mut found: Vec<_> = entries.filter_map(process).collect();
    found.sort();
    found
}

/// Whether a process has the port open; `None` if this user may not see.
fn has_open(root: &Path, pid: u32, port: &Path) -> Option<bool> {
    let open = fs::read_dir(root.join(format!("proc/{pid}/fd"))).ok()?;
    Some(open.flatten().any(|fd| fs::read_link(fd.path()).is_ok_and(|link| link == port)))
}

/// Which other programs have this port open. If one is `known` to, but cannot be seen, the finding says so.
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

/// Whether ModemManager, which looks for a modem at every serial port, runs without a rule to leave boards alone.
pub(super) fn modem_manager(root: &Path) -> Option<Finding> {
    let runs = processes(root).into_iter().any(|process| process.name == MODEM_MANAGER);
    let ignored = service::rules_text(root).is_some_and(|rules| rules.contains("ID_MM_DEVICE_IGNORE"));
    (runs && !ignored).then(|| {
        let advice = format!(
            "`sudo cp deploy/70-meissner.rules /etc/udev/rules.d/ && {}`, or, on a machine without a modem, `sudo \
             systemctl disable --now ModemManager`",
            service::RELOAD
        );
        Finding::warn("ModemManager", "it runs, and no udev rule keeps it from writing to boards", advice)
    })
}

/// Boards that the kernel may put to sleep when they are silent: waking one takes longer than a stroke may wait.
pub(super) fn autosuspend(root: &Path) -> Vec<Finding> {
    let entries = fs::read_dir(root.join(USB)).into_iter().flatten().flatten();
    let mut sleepy: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(|path| may_sleep(path)).collect();
    sleepy.sort();
    let finding = |path: PathBuf| {
        let path = Path::new("/").join(path.strip_prefix(root).unwrap_or(&path));
        let found = format!("the kernel may put the board at {} to sleep", path.display());
        let advice = format!(
            "`echo on | sudo tee {}/power/control` (until it is plugged in again); the udev rules do it for good",
            path.display()
        );
        Finding::warn("autosuspend", found, advice)
    };
    sleepy.into_iter().map(finding).collect()
}

fn may_sleep(device: &Path) -> bool {
    let of = |name: &str| fs::read_to_string(device.join(name)).ok().map(|text| text.trim().to_owned());
    let id = |name| u16::from_str_radix(&of(name)?, 16).ok();
    let (Some(vendor), Some(product)) = (id("idVendor"), id("idProduct")) else { return false };
    let is_board = BoardQuery::default().matches((vendor, product), of("product").as_deref(), None);
    is_board && of("power/control").as_deref() == Some("auto")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::doctor::finding::fake;
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

    #[test]
    fn modem_manager_needs_a_udev_rule() {
        let dir = machine(&[(5, "ModemManager", "/dev/null")]);
        let line = fake::line(&modem_manager(dir.path()).unwrap());
        assert!(line.starts_with("Warn ModemManager: it runs") && line.contains("sudo cp deploy/"), "{line}");
        let rules = include_str!("../../../deploy/70-meissner.rules");
        fake::write(dir.path(), "etc/udev/rules.d/70-meissner.rules", rules);
        assert!(modem_manager(dir.path()).is_none());
        assert!(modem_manager(machine(&[(5, "bash", "/dev/null")]).path()).is_none());
    }

    #[test]
    fn a_board_that_may_sleep_is_reported() {
        let dir = tempfile::tempdir().unwrap();
        let device = |at: &str, product: &str, control: &str| {
            for (name, text) in [("idVendor", "1209"), ("idProduct", "0001"), ("product", product)] {
                fake::write(dir.path(), &format!("{USB}/{at}/{name}"), &format!("{text}\n"));
            }
            fake::write(dir.path(), &format!("{USB}/{at}/power/control"), &format!("{control}\n"));
        };
        device("1-1", "meissner", "on");
        device("1-2", "blinky", "auto");
        fake::write(dir.path(), &format!("{USB}/1-1:1.0/power/control"), "auto\n");
        assert!(autosuspend(dir.path()).is_empty());
        device("1-4.2", "meissner", "auto");
        assert_eq!(
            fake::all(&autosuspend(dir.path())),
            [
                "Warn autosuspend: the kernel may put the board at /sys/bus/usb/devices/1-4.2 to sleep -> `echo on | sudo tee \
              /sys/bus/usb/devices/1-4.2/power/control` (until it is plugged in again); the udev rules do it for good"
            ]
        );
    }
}
