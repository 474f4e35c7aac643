//! The doctor's checks that command and daemon share: of the machine, of a daemon, and of its device.
//!
//! `meissner doctor` makes them for the machine it runs on and the daemon it reaches; `GET /v1/doctor` makes them inside the daemon
//! ([`check`]). Checks of the user's rights, of timers and of a device without a daemon belong to the command (`cli/doctor`).
//!
//! - [`host`] (processors), [`service`] (its unit), [`port`] (what the system does to boards): the machine.
//! - [`rights`] (real time), [`daemon`] (version, session record, network): a daemon, by its status.
//! - [`device`]: its device.
//!
//! Invariant: a check that cannot see what it is to judge reports that. Nothing here moves, changes or repairs anything.

pub(crate) mod daemon;
pub(crate) mod device;
mod host;
pub(crate) mod port;
pub(crate) mod rights;
pub(crate) mod service;

use meissner_api::{DoctorReport, Finding, Status};
use service::Units;
use std::path::Path;

/// Runs every check for a daemon that runs on this machine. Waits for the disk, and up to 3 s for systemd.
pub(crate) fn check(root: &Path, status: &Status) -> DoctorReport {
    let units = service::units(root);
    let mut findings = machine(root, &units);
    findings.extend(daemon::findings(root, status, &units));
    findings.extend(device::findings(status));
    findings.into()
}

/// The checks of this machine.
pub(crate) fn machine(root: &Path, units: &Units) -> Vec<Finding> {
    let mut findings = vec![host::governor(root)];
    findings.extend(service::findings(root, units));
    findings.extend(port::autosuspend(root));
    findings.extend(port::modem_manager(root));
    findings
}

/// Helpers for the tests of all checks: the files of a simulated machine, and findings as text.
#[cfg(test)]
pub(crate) mod fake {
    use meissner_api::{Finding, Level};
    use std::fs;
    use std::path::Path;

    /// Writes a file, and the directories it needs, below a root.
    pub(crate) fn write(root: &Path, path: &str, text: &str) {
        let file = root.join(path);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    }

    /// A finding on one line: level, what, found, advice.
    pub(crate) fn line(finding: &Finding) -> String {
        let Finding { what, level, found, advice } = finding;
        assert_eq!(*level == Level::Ok, advice.is_empty(), "{finding:?}");
        format!("{level:?} {what}: {found} -> {advice}")
    }

    pub(crate) fn all<'a>(findings: impl IntoIterator<Item = &'a Finding>) -> Vec<String> {
        findings.into_iter().map(line).collect()
    }
}
