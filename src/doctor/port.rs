//! Checks whether the system by itself writes to boards or puts them to sleep.
//!
//! It reads `/proc` and `/sys` with this user's rights, and opens no port. It does not check hubs: a hub sleeps only when all
//! devices behind it sleep, so a board that stays awake keeps its hubs awake.

use super::service;
use meissner_api::Finding;
use meissner_stream::device::find::BoardQuery;
use std::fs;
use std::path::{Path, PathBuf};

const USB: &str = "sys/bus/usb/devices";
pub(crate) const MODEM_MANAGER: &str = "ModemManager";

/// A process by number and name.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Process {
    pub(crate) pid: u32,
    pub(crate) name: String,
}

/// The processes that this user may see.
pub(crate) fn processes(root: &Path) -> Vec<Process> {
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

/// Whether ModemManager, which looks for a modem at every serial port, runs without a rule to leave boards alone.
pub(super) fn modem_manager(root: &Path) -> Option<Finding> {
    if service::rules_text(root).is_some_and(|rules| rules.contains("ID_MM_DEVICE_IGNORE")) {
        return None;
    }
    let seen = processes(root);
    let advice = format!(
        "`sudo cp deploy/70-meissner.rules /etc/udev/rules.d/ && {}`, or, on a machine without a modem, `sudo \
         systemctl disable --now ModemManager`",
        service::RELOAD
    );
    let found = if seen.iter().any(|process| process.name == MODEM_MANAGER) {
        "it runs, and no udev rule keeps it from writing to boards"
    } else if seen.iter().any(|process| process.pid == 1) {
        return None;
    } else {
        // A service sees only its own processes (ProtectProc=invisible).
        "no udev rule keeps it from writing to boards; whether it runs cannot be seen from here"
    };
    Some(Finding::warn(MODEM_MANAGER, found, advice))
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
    use crate::doctor::fake;

    #[test]
    fn modem_manager_needs_a_udev_rule() {
        let dir = tempfile::tempdir().unwrap();
        let line = || modem_manager(dir.path()).map(|finding| fake::line(&finding));
        fake::write(dir.path(), "proc/5/comm", "bash\n");
        let hidden = line().unwrap();
        assert!(
            hidden.ends_with("disable --now ModemManager`") && hidden.contains("cannot be seen from here ->"),
            "{hidden}"
        );
        fake::write(dir.path(), "proc/1/comm", "systemd\n");
        assert_eq!(line(), None);
        fake::write(dir.path(), "proc/7/comm", "ModemManager\n");
        let runs = line().unwrap();
        assert!(runs.starts_with("Warn ModemManager: it runs") && runs.contains("sudo cp deploy/"), "{runs}");
        let rules = include_str!("../../deploy/70-meissner.rules");
        fake::write(dir.path(), "etc/udev/rules.d/70-meissner.rules", rules);
        assert_eq!(line(), None);
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
