//! The doctor's look at the boards' ports: who else has one open, and what the system does to them by itself.
//!
//! It reads `/proc` and `/sys`, as far as this user may, and opens no port. A board's hubs are not looked at: a hub sleeps
//! only when all behind it sleep, so a board that stays awake keeps them awake.
//!
//! Invariant: what could not be looked into is not called free.

use super::Finding;
use super::service;
use meissner_stream::device::find::BoardQuery;
use std::fs;
use std::path::{Path, PathBuf};

const USB: &str = "sys/bus/usb/devices";
const MODEM_MANAGER: &str = "ModemManager";

/// What one process is called, and its number.
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

/// Whether a process has the port open; `None` if it does not let us see.
fn has_open(root: &Path, pid: u32, port: &Path) -> Option<bool> {
    let open = fs::read_dir(root.join(format!("proc/{pid}/fd"))).ok()?;
    Some(open.flatten().any(|fd| fs::read_link(fd.path()).is_ok_and(|link| link == port)))
}

/// Who else has this port open; where it is known that somebody has, also that nobody could be seen.
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
        let found = format!("who has {} open cannot be seen without root's rights", port.display());
        let ask = format!("`sudo fuser -v {}` tells", port.display());
        return (known && hidden).then(|| Finding::warn("port", found, ask));
    };
    let names: Vec<_> = holders.iter().map(|Process { pid, name }| format!("{name} (pid {pid})")).collect();
    let found = format!("{} is open in {}", port.display(), names.join(", "));
    let advice = match name.as_str() {
        "meissner" => format!(
            "`meissner status` asks that daemon; `sudo systemctl stop meissner`, or `kill {pid}`, ends it"
        ),
        MODEM_MANAGER => {
            "install the udev rules, which tell it to leave boards alone, and plug it in again".to_owned()
        }
        _ => format!("end it: `kill {pid}`"),
    };
    Some(Finding::warn("port", found, advice))
}

/// Whether something that tries every serial port for a modem was not told to leave boards alone.
pub(super) fn modem_manager(root: &Path) -> Option<Finding> {
    let runs = processes(root).into_iter().any(|process| process.name == MODEM_MANAGER);
    let told = service::rules_text(root).is_some_and(|rules| rules.contains("ID_MM_DEVICE_IGNORE"));
    (runs && !told).then(|| {
        let advice = "`sudo cp deploy/70-meissner.rules /etc/udev/rules.d/ && sudo udevadm control --reload && sudo \
                      udevadm trigger`, or, where no modem is, `sudo systemctl disable --now ModemManager`";
        Finding::warn("ModemManager", "it runs, and no udev rule keeps it from writing to boards", advice)
    })
}

/// Boards that the kernel may put to sleep when they are silent: waking one takes longer than a stroke may.
pub(super) fn autosuspend(root: &Path) -> Vec<Finding> {
    let entries = fs::read_dir(root.join(USB)).into_iter().flatten().flatten();
    let mut sleepy: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(|path| may_sleep(path)).collect();
    sleepy.sort();
    let finding = |path: PathBuf| {
        let path = Path::new("/").join(path.strip_prefix(root).unwrap_or(&path));
        let found = format!("the board at {} may be put to sleep", path.display());
        let advice = format!(
            "`echo on | sudo tee {}/power/control`, until it is plugged in again; the udev rules do it for good",
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
    use super::super::fake;
    use super::*;
    use std::os::unix::fs::symlink;
    use tempfile::TempDir;

    /// A machine on which these run; the port they have open, if any.
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
    fn who_has_a_port_open_is_named() {
        let port = "/dev/no-such-port";
        let line = |running: &[_], known| {
            holders(machine(running).path(), Path::new(port), known).map(|finding| fake::line(&finding))
        };
        let ours = (std::process::id(), "meissner", port);
        assert_eq!(line(&[(7, "bash", "/dev/tty1"), ours], true), None);
        assert_eq!(
            line(&[(90, "minicom", port), (7, "bash", "/dev/tty1"), (412, "cat", port)], false).unwrap(),
            "Warn port: /dev/no-such-port is open in minicom (pid 90), cat (pid 412) -> end it: `kill 90`"
        );
        let daemon = line(&[(812, "meissner", port)], true).unwrap();
        assert!(daemon.contains("-> `meissner status`") && daemon.contains("`kill 812`"), "{daemon}");
        assert!(line(&[(812, MODEM_MANAGER, port)], true).unwrap().contains("-> install the udev rules"));
    }

    #[test]
    fn what_could_not_be_looked_into_is_not_called_free() {
        let dir = machine(&[]);
        fake::write(dir.path(), "proc/1/comm", "init");
        let port = Path::new("/dev/no-such-port");
        assert_eq!(
            fake::line(&holders(dir.path(), port, true).unwrap()),
            "Warn port: who has /dev/no-such-port open cannot be seen without root's rights -> `sudo fuser -v \
             /dev/no-such-port` tells"
        );
        assert!(holders(dir.path(), port, false).is_none(), "it could be opened");
    }

    #[test]
    fn a_modem_manager_must_have_been_told() {
        let dir = machine(&[(5, "ModemManager", "/dev/null")]);
        let line = fake::line(&modem_manager(dir.path()).unwrap());
        assert!(line.starts_with("Warn ModemManager: it runs") && line.contains("sudo cp deploy/"), "{line}");
        let rules = include_str!("../../../deploy/70-meissner.rules");
        fake::write(dir.path(), "etc/udev/rules.d/70-meissner.rules", rules);
        assert!(modem_manager(dir.path()).is_none());
        assert!(modem_manager(machine(&[(5, "bash", "/dev/null")]).path()).is_none());
    }

    #[test]
    fn a_board_that_may_sleep_is_told_of() {
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
                "Warn autosuspend: the board at /sys/bus/usb/devices/1-4.2 may be put to sleep -> `echo on | sudo tee \
              /sys/bus/usb/devices/1-4.2/power/control`, until it is plugged in again; the udev rules do it for good"
            ]
        );
    }
}
