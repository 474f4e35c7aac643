//! The daemon as a service: notifications, watchdog, socket activation.

use crate::harness::{Daemon, PROGRAM, TIMEOUT, complaint, meissner, offline, printed};
use meissner_api::Status;
use rustix::process::Signal;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::{UnixDatagram, UnixListener};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A service manager's end of the notifications.
struct Manager {
    socket: UnixDatagram,
    dir: tempfile::TempDir,
}

impl Manager {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let socket = UnixDatagram::bind(dir.path().join("notify")).unwrap();
        socket.set_read_timeout(Some(TIMEOUT)).unwrap();
        Self { socket, dir }
    }

    /// Starts a daemon as a service manager does: without a terminal, with a notification socket.
    fn start(&self, watchdog: Option<Duration>) -> Daemon {
        let mut command = Command::new(PROGRAM);
        command.stdin(Stdio::null());
        command.env("NOTIFY_SOCKET", self.dir.path().join("notify")).env_remove("WATCHDOG_PID");
        match watchdog {
            Some(interval) => command.env("WATCHDOG_USEC", interval.as_micros().to_string()),
            None => command.env_remove("WATCHDOG_USEC"),
        };
        Daemon::by(command)
    }

    /// Receives a notification; a signal of this process does not end the wait.
    fn receive(&self) -> io::Result<String> {
        let mut bytes = [0; 4096];
        loop {
            match self.socket.recv(&mut bytes) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                received => {
                    let bytes = &bytes[..received?];
                    return Ok(String::from_utf8_lossy(bytes).trim_end().to_owned());
                }
            }
        }
    }

    fn wait_for(&self, what: impl Fn(&str) -> bool) -> String {
        let begun = Instant::now();
        loop {
            let text = self.receive().expect("a notification in time");
            if what(&text) {
                return text;
            }
            assert!(begun.elapsed() < TIMEOUT, "not received; last `{text}`");
        }
    }

    /// Whether no notification comes for this long.
    fn is_silent(&self, during: Duration) -> bool {
        self.socket.set_read_timeout(Some(during)).unwrap();
        let received = self.receive();
        self.socket.set_read_timeout(Some(TIMEOUT)).unwrap();
        received.is_err()
    }
}

#[test]
fn a_service_manager_gets_ready_status_and_stopping() {
    let manager = Manager::new();
    let mut daemon = manager.start(None);
    manager.wait_for(|text| text == "READY=1");
    let status: Status = daemon.client().get("/v1/status").unwrap();
    assert!(status.is_connected(), "the first command finds a device");
    daemon.armed();
    manager.wait_for(|text| text.starts_with("STATUS=armed") && text.contains("mock, simulated"));
    printed(daemon.meissner().args(["play", "wave", "--endless"]));
    manager.wait_for(|text| text.contains("plays wave (play 1)"));
    printed(daemon.meissner().arg("stop"));
    manager.wait_for(|text| text.starts_with("STATUS=armed") && !text.contains("plays"));
    assert!(manager.is_silent(Duration::from_millis(300)), "an idle daemon sends nothing");
    daemon.signal(Signal::TERM);
    manager.wait_for(|text| text == "STOPPING=1");
    assert!(daemon.wait().success());
}

#[test]
fn a_daemon_that_hangs_sends_no_watchdog_notification() {
    let manager = Manager::new();
    let mut daemon = manager.start(Some(Duration::from_millis(200)));
    for _ in 0..3 {
        manager.wait_for(|text| text == "WATCHDOG=1");
    }
    daemon.signal(Signal::STOP);
    while !manager.is_silent(Duration::from_millis(400)) {}
    daemon.signal(Signal::CONT);
    manager.wait_for(|text| text == "WATCHDOG=1");
    assert!(daemon.end().success());
}

#[test]
fn a_socket_that_is_handed_over_is_used_and_not_removed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("activated.sock");
    let listener = UnixListener::bind(&path).unwrap();
    // Connect before a daemon runs, like the command that starts it.
    let first = std::thread::spawn({
        let path = path.clone();
        move || printed(meissner().args(["arm", "--assume-rest", "--socket"]).arg(path))
    });
    let mut command = Command::new("sh");
    let script = "exec 3<&0 </dev/null; LISTEN_PID=$$ LISTEN_FDS=1 exec \"$0\" \"$@\"";
    command.args(["-c", script, PROGRAM]).stdin(Stdio::from(OwnedFd::from(listener)));
    let mut daemon = Daemon::by(command);
    assert!(first.join().unwrap().starts_with("armed"), "it waits for the device");
    assert!(!daemon.socket().exists(), "it makes no socket of its own");
    assert!(daemon.wait_for_log("listening on").contains(&format!("listening on {}", path.display())));
    assert!(daemon.log().contains("`socket` in the configuration is ignored"));
    assert!(daemon.end().success());
    assert!(
        std::fs::symlink_metadata(&path).unwrap().file_type().is_socket(),
        "the daemon does not remove it"
    );
}

#[test]
fn a_configuration_is_checked_without_a_daemon() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("m.toml");
    let check = || {
        let mut command = offline();
        command.args(["daemon", "--check-config", "--device", "mock", "--config"]).arg(&file);
        command
    };
    std::fs::write(&file, "lead_ms = 50\n").unwrap();
    assert!(printed(&mut check()).ends_with("m.toml: valid\n"));
    for (text, says) in [
        ("laed_ms = 50\n", "m.toml:1: unknown key `laed_ms`: did you mean `lead_ms`?"),
        ("patterns_dir = \"/nonexistent/patterns\"\n", "m.toml: `patterns_dir`: /nonexistent/patterns"),
        ("logbook_dir = \"/nonexistent/a/b\"\n", "m.toml: `logbook_dir`: /nonexistent/a/b: neither it nor"),
        (&format!("socket = \"/{}\"\n", "x".repeat(200)), "at most 101 bytes"),
        ("socket = \"/a\\u0000\"\n", "`socket` holds a control character"),
        ("array.description = \"bad.toml\"\n", "bad.toml"),
    ] {
        std::fs::write(&file, text).unwrap();
        let line = complaint(&mut check());
        assert!(line.contains(says), "{line}");
    }
}
