//! Tests each finding about the installation, good and bad, on simulated machines.
//!
//! Nothing here depends on what is installed on the machine that runs it.

use super::*;
use crate::doctor::fake;
use std::fs;
use tempfile::TempDir;

/// A machine with systemd and our service.
fn installed() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    fake::write(dir.path(), "usr/lib/systemd/system/meissner.service", "");
    fs::create_dir_all(dir.path().join("run/systemd/system")).unwrap();
    dir
}

const GOOD: &str = "Id=meissner.service\nLoadState=loaded\nActiveState=active\nSubState=running\n\
                    UnitFileState=enabled\nResult=success\nMainPID=812\n\n\
                    Id=meissner.socket\nLoadState=loaded\nActiveState=active\nSubState=running\n\
                    UnitFileState=enabled\nResult=success\n";

/// The findings about units, after these changes to systemd's report about good ones.
fn found(changes: &[(&str, &str)]) -> Vec<String> {
    let dir = installed();
    let text = changes.iter().fold(GOOD.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    });
    fake::all(&state(&Units::new(dir.path(), Some(text))))
}

#[test]
fn nothing_is_wrong_where_nothing_is_installed() {
    let dir = tempfile::tempdir().unwrap();
    let units = Units::new(dir.path(), None);
    assert_eq!(
        fake::all(&findings(dir.path(), &units)),
        ["Ok service: no service is installed: start `meissner daemon` by hand -> "]
    );
    assert!(!units.runs(812));
}

#[test]
fn good_units_give_two_findings() {
    assert_eq!(
        found(&[]),
        [
            "Ok service: meissner.service is active (running) -> ",
            "Ok socket unit: meissner.socket is active (running) -> "
        ]
    );
    let idle = found(&[("ActiveState=active\nSubState=running", "ActiveState=inactive\nSubState=dead")]);
    assert_eq!(idle[0], "Ok service: meissner.service is inactive, and starts with the first client -> ");
    assert_eq!(idle.len(), 2);
    let dir = installed();
    let units = Units::new(dir.path(), Some(GOOD.to_owned()));
    assert!(units.runs(812) && !units.runs(81) && units.is_installed());
}

#[test]
fn bad_units_are_reported_with_what_repairs_them() {
    let stopped = ("ActiveState=active\nSubState=running", "ActiveState=inactive\nSubState=dead");
    let disabled = ("UnitFileState=enabled", "UnitFileState=disabled");
    type Case<'a> = (&'a [(&'a str, &'a str)], &'a str);
    let cases: [Case<'_>; 5] = [
        (
            &[("ActiveState=active", "ActiveState=failed"), ("Result=success", "Result=exit-code")],
            "Fail service: meissner.service failed (exit-code) -> `journalctl -u meissner.service -e` shows why",
        ),
        (
            &[("ActiveState=active\nSubState=running", "ActiveState=activating\nSubState=auto-restart")],
            "Fail service: systemd restarts meissner.service again and again (success) -> `journalctl -u meissner.service -e` shows why",
        ),
        (
            &[stopped, ("LoadState=loaded", "LoadState=masked")],
            "Warn service: meissner.service is inactive (masked) -> `sudo systemctl start meissner.socket meissner.service`, or see \
             `systemctl status meissner.service`",
        ),
        (
            &[stopped, stopped],
            "Warn service: meissner.service is inactive (loaded) -> `sudo systemctl start meissner.socket meissner.service`, or see \
             `systemctl status meissner.service`",
        ),
        (
            &[disabled, disabled],
            "Warn boot: neither unit is enabled, so no daemon runs after a boot -> `sudo systemctl enable --now \
             meissner.socket meissner.service`",
        ),
    ];
    for (changes, message) in cases {
        let lines = found(changes);
        assert!(lines.iter().any(|line| line == message), "{message}\n{lines:#?}");
    }
    // An active socket starts the daemon on demand.
    assert_eq!(found(&[disabled]).len(), 2);
    let dir = installed();
    let mute = fake::all(&state(&Units::new(dir.path(), None)));
    assert!(
        mute.len() == 1 && mute[0].starts_with("Warn service: the service is installed, but systemd"),
        "{mute:?}"
    );
}

#[test]
fn a_bad_configuration_is_reported_with_its_line() {
    let dir = tempfile::tempdir().unwrap();
    assert!(config(dir.path()).is_none());
    fake::write(dir.path(), CONFIG, "lead_ms = 50\n");
    assert_eq!(
        fake::line(&config(dir.path()).unwrap()),
        "Ok configuration: /etc/meissner/meissner.toml is valid -> "
    );
    fake::write(dir.path(), CONFIG, "\nlaed_ms = 50\n");
    let line = fake::line(&config(dir.path()).unwrap());
    assert!(
        line.starts_with("Fail configuration: ") && line.contains("meissner.toml:2: unknown key"),
        "{line}"
    );
    assert!(line.ends_with("then `sudo systemctl restart meissner.service`"), "{line}");
}

#[test]
fn missing_rules_are_reported() {
    let dir = installed();
    let units = Units::new(dir.path(), None);
    let line = || fake::line(&rules(dir.path(), &units).unwrap());
    assert!(line().starts_with("Warn udev rules: no rules for boards"), "{}", line());
    assert!(rules(dir.path(), &Units::default()).is_none());
    fake::write(dir.path(), RULES[2], "");
    assert_eq!(line(), "Ok udev rules: /usr/lib/udev/rules.d/70-meissner.rules -> ");
}

#[test]
fn a_command_that_does_not_end_is_killed() {
    let sh = |script: &str| {
        let mut sh = Command::new("sh");
        sh.args(["-c", script]);
        sh
    };
    assert_eq!(said(sh("echo Id=a"), Duration::from_secs(20)).unwrap(), "Id=a\n");
    let slow = said(sh("exec sleep 600"), Duration::from_millis(50)).unwrap_err();
    assert_eq!(slow.kind(), io::ErrorKind::TimedOut);
    assert!(said(Command::new("no-such-command"), TIMEOUT).is_err());
}
