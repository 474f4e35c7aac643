//! Checks whether the system by itself writes to boards or puts them to sleep.
//!
//! It reads files with this user's rights, and opens no port. It does not check hubs: a hub sleeps only when all
//! devices behind it sleep, so a board that stays awake keeps its hubs awake.

use super::service;
use meissner_api::Finding;
use meissner_stream::device::find::BoardQuery;
use std::fs;
use std::path::{Path, PathBuf};

const USB: &str = "sys/bus/usb/devices";
/// The program that looks for a modem at every serial port.
const MODEM_MANAGER: &str = "usr/sbin/ModemManager";

/// Whether ModemManager is installed, without the udev rules which make it leave boards alone.
pub(super) fn modem_manager(root: &Path) -> Option<Finding> {
    let disturbs = service::rules_file(root).is_none() && root.join(MODEM_MANAGER).exists();
    disturbs.then(|| {
        let advice = "install the udev rules (deploy/70-meissner.rules), or, on a machine without a modem, `sudo systemctl disable \
                      --now ModemManager`";
        Finding::warn("ModemManager", "no udev rule keeps it from writing to boards", advice)
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
    use crate::doctor::fake;

    #[test]
    fn modem_manager_needs_a_udev_rule() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(modem_manager(dir.path()), None);
        fake::write(dir.path(), MODEM_MANAGER, "");
        let line = fake::line(&modem_manager(dir.path()).unwrap());
        assert!(
            line.starts_with("Warn ModemManager: no udev rule")
                && line.ends_with("disable --now ModemManager`"),
            "{line}"
        );
        fake::write(dir.path(), "etc/udev/rules.d/70-meissner.rules", "");
        assert_eq!(modem_manager(dir.path()), None);
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
