//! Checks the installation: systemd's units, the configuration and udev's rules.
//!
//! `systemctl show` reports the units; it needs no rights, and a check waits at most [`TIMEOUT`] for it. If nothing is installed,
//! one finding says so, because a daemon may be started by hand.
//!
//! Invariant: on a machine with nothing installed every finding here is `ok`.

use crate::config::{Config, ConfigError};
use meissner_api::Finding;
use meissner_client::is_installed;
use std::collections::HashMap;
use std::io::{self, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// How long `systemctl` may take.
const TIMEOUT: Duration = Duration::from_secs(3);
const ASKED: &str = "Id,LoadState,ActiveState,SubState,UnitFileState,Result,MainPID";
const SERVICE: &str = "meissner.service";
const SOCKET: &str = "meissner.socket";
const CONFIG: &str = "etc/meissner/meissner.toml";
/// Where rules may be installed.
const RULES: [&str; 4] = [
    "etc/udev/rules.d/70-meissner.rules",
    "usr/local/lib/udev/rules.d/70-meissner.rules",
    "usr/lib/udev/rules.d/70-meissner.rules",
    "lib/udev/rules.d/70-meissner.rules",
];
const RELOAD: &str = "sudo udevadm control --reload && sudo udevadm trigger";

/// What systemd reports about our units; empty if none is installed.
#[derive(Debug, Default)]
pub(crate) struct Units {
    installed: bool,
    reported: HashMap<String, HashMap<String, String>>,
}

impl Units {
    pub(crate) fn new(root: &Path, reported: Option<String>) -> Self {
        let reported = reported.as_deref().map(parse).unwrap_or_default();
        Self { installed: is_installed(root), reported }
    }

    pub(crate) const fn is_installed(&self) -> bool {
        self.installed
    }

    /// Whether this process is the service.
    pub(super) fn runs(&self, pid: u32) -> bool {
        self.of(SERVICE, "MainPID") == pid.to_string()
    }

    fn of(&self, unit: &str, property: &str) -> &str {
        self.reported.get(unit).and_then(|unit| unit.get(property)).map_or("", String::as_str)
    }
}

/// Asks systemd about our units, if they are installed.
pub(crate) fn units(root: &Path) -> Units {
    let mut show = Command::new("systemctl");
    show.args(["show", SERVICE, SOCKET, "--no-pager", "-p", ASKED]);
    let reported =
        move || said(show, TIMEOUT).inspect_err(|error| tracing::debug!("systemctl: {error}")).ok();
    Units::new(root, is_installed(root).then(reported).flatten())
}

/// The output of a command that ends within `timeout`.
fn said(mut command: Command, timeout: Duration) -> io::Result<String> {
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn()?;
    let until = Instant::now() + timeout;
    // The output fits into the pipe, so the command can end before its output is read.
    while child.try_wait()?.is_none() {
        if Instant::now() > until {
            child.kill()?;
            child.wait()?;
            return Err(io::ErrorKind::TimedOut.into());
        }
        thread::sleep(Duration::from_millis(10));
    }
    let mut text = String::new();
    child.stdout.take().ok_or(io::ErrorKind::BrokenPipe)?.read_to_string(&mut text)?;
    Ok(text)
}

/// Blocks of `Property=value`, one for each unit.
fn parse(text: &str) -> HashMap<String, HashMap<String, String>> {
    let block = |block: &str| {
        let pairs = block.lines().filter_map(|line| line.split_once('='));
        let pairs: HashMap<_, _> = pairs.map(|(name, value)| (name.to_owned(), value.to_owned())).collect();
        Some((pairs.get("Id")?.clone(), pairs))
    };
    text.split("\n\n").filter_map(block).collect()
}

/// Runs every check of this module.
pub(super) fn findings(root: &Path, units: &Units) -> Vec<Finding> {
    let mut findings = state(units);
    findings.extend(config(root));
    findings.extend(rules(root, units));
    findings
}

fn state(units: &Units) -> Vec<Finding> {
    if !units.installed {
        return vec![Finding::ok("service", "no service is installed: start `meissner daemon` by hand")];
    }
    if units.reported.is_empty() {
        let advice = "see `systemctl status meissner.service`";
        return vec![Finding::warn(
            "service",
            "the service is installed, but systemd does not report its state",
            advice,
        )];
    }
    let mut findings = Vec::new();
    for (what, unit) in [("service", SERVICE), ("socket unit", SOCKET)] {
        let of = |property| units.of(unit, property);
        let (load, active, sub) = (of("LoadState"), of("ActiveState"), of("SubState"));
        findings.push(match active {
            "failed" => {
                let found = format!("{unit} failed ({})", of("Result"));
                Finding::fail(what, found, format!("`journalctl -u {unit} -e` shows why"))
            }
            _ if sub == "auto-restart" => {
                let found = format!("systemd restarts {unit} again and again ({})", of("Result"));
                Finding::fail(what, found, format!("`journalctl -u {unit} -e` shows why"))
            }
            "active" | "activating" | "reloading" => Finding::ok(what, format!("{unit} is {active} ({sub})")),
            // The service starts when a client connects.
            _ if load == "loaded" && unit == SERVICE && units.of(SOCKET, "ActiveState") == "active" => {
                Finding::ok(what, format!("{unit} is {active}, and starts with the first client"))
            }
            _ => {
                let advice =
                    format!("`sudo systemctl start {SOCKET} {SERVICE}`, or see `systemctl status {unit}`");
                Finding::warn(what, format!("{unit} is {active} ({load})"), advice)
            }
        });
    }
    let enabled = |unit| matches!(units.of(unit, "UnitFileState"), "enabled" | "enabled-runtime" | "static");
    if !enabled(SERVICE) && !enabled(SOCKET) {
        let advice = format!("`sudo systemctl enable --now {SOCKET} {SERVICE}`");
        findings.push(Finding::warn(
            "boot",
            "neither unit is enabled, so no daemon runs after a boot",
            advice,
        ));
    }
    findings
}

fn config(root: &Path) -> Option<Finding> {
    let file = root.join(CONFIG);
    // If the search for the file fails, the code that reads it reports that.
    if matches!(file.try_exists(), Ok(false)) {
        return None;
    }
    Some(match Config::read(&file) {
        Ok(_) => Finding::ok("configuration", format!("/{CONFIG} is valid")),
        Err(ConfigError::Read { source, .. }) if source.kind() == io::ErrorKind::PermissionDenied => {
            let advice = "run `sudo meissner doctor`, which checks it";
            Finding::warn("configuration", format!("the doctor may not read /{CONFIG} here"), advice)
        }
        Err(error) => {
            let advice = format!("correct that line, then `sudo systemctl restart {SERVICE}`");
            Finding::fail("configuration", error.to_string(), advice)
        }
    })
}

/// The rules that udev uses.
pub(super) fn rules_file(root: &Path) -> Option<&'static str> {
    RULES.into_iter().find(|rules| root.join(rules).exists())
}

fn rules(root: &Path, units: &Units) -> Option<Finding> {
    units.installed.then(|| match rules_file(root) {
        Some(used) => Finding::ok("udev rules", format!("/{used}")),
        None => {
            let advice = format!(
                "install the package again: `sudo apt install --reinstall ./meissner_*.deb && {RELOAD}`"
            );
            Finding::warn(
                "udev rules",
                "no rules for boards are installed: the service may not be allowed to open one",
                advice,
            )
        }
    })
}

#[cfg(test)]
mod tests;
