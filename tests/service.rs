//! The daemon as a service: notifications, watchdog, socket activation, reload, and a newer program.

use crate::harness::{Daemon, PATIENT, PROGRAM, TIMEOUT, complaint, meissner, printed};
use meissner_api::Status;
use rustix::process::Signal;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::{UnixDatagram, UnixListener};
use std::path::Path;
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

    fn start(&self, watchdog: Option<Duration>) -> Daemon {
        self.start_program(PROGRAM.as_ref(), watchdog)
    }

    /// Starts a program as a service manager does: without a terminal, with a notification socket.
    fn start_program(&self, program: &Path, watchdog: Option<Duration>) -> Daemon {
        let mut command = Command::new("sh");
        command.args(["-c", "trap '' HUP; exec \"$0\" \"$@\""]).arg(program).stdin(Stdio::null());
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
fn a_slow_client_costs_no_watchdog_notification() {
    use std::io::Write;
    let manager = Manager::new();
    let daemon = manager.start(Some(Duration::from_millis(200)));
    manager.wait_for(|text| text == "READY=1");
    let mut slow = std::os::unix::net::UnixStream::connect(daemon.socket()).unwrap();
    // This is shorter than the daemon would wait for the rest of the request.
    manager.socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    slow.write_all(b"POST /v1/play HTTP/1.1\r\nHost: m\r\nContent-Length: 999\r\n\r\n{").unwrap();
    for _ in 0..5 {
        manager.wait_for(|text| text == "WATCHDOG=1");
    }
}

/// Copy it in another process, so that no child of another test holds it open for writing when it is started.
fn copy_program(to: &Path) {
    assert!(Command::new("cp").arg(PROGRAM).arg(to).status().unwrap().success());
}

#[test]
fn a_newer_program_is_started_when_motors_are_disarmed() {
    let manager = Manager::new();
    let program = manager.dir.path().join("meissner");
    copy_program(&program);
    let mut daemon = manager.start_program(&program, None);
    daemon.wait_for_device();
    daemon.armed();
    let newer = manager.dir.path().join("newer");
    copy_program(&newer);
    std::fs::rename(newer, &program).unwrap();
    printed(daemon.meissner().args(["play", "wave", "--seconds", "0.2", "--wait"]));
    let status: Status = daemon.client().get("/v1/status").unwrap();
    assert_eq!(status.state, "armed", "a session goes on");
    printed(daemon.meissner().arg("disarm"));
    assert_eq!(daemon.wait().code(), Some(75), "{}", daemon.log());
    assert!(daemon.log().contains("another version was installed"));
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
fn a_reload_applies_what_can_change_and_names_the_rest() {
    let manager = Manager::new();
    let daemon = manager.start(None);
    manager.wait_for(|text| text == "READY=1");
    let status = || daemon.client().get::<Status>("/v1/status").unwrap();
    let reload = |config: &str| {
        daemon.write_config(config);
        daemon.signal(Signal::HUP);
        manager.wait_for(|text| text.starts_with("RELOADING=1"));
        manager.wait_for(|text| text == "READY=1");
        daemon.log().lines().last().unwrap().to_owned()
    };
    assert!(reload(PATIENT).contains("has not changed"));
    daemon.armed();
    let line = reload("lead_ms = 800\nlease_ms = 8000\n");
    assert!(line.contains("`lead_ms`") && line.contains("from the next `arm` on"), "{line}");
    // An answer to a later command shows that the settings have arrived.
    printed(daemon.meissner().args(["play", "wave", "--seconds", "0.3", "--wait"]));
    assert_eq!((status().lead_ms, status().lease_ms), (900.0, 10_000.0), "armed with these");
    printed(daemon.meissner().arg("disarm"));
    daemon.armed();
    assert_eq!((status().lead_ms, status().lease_ms), (800.0, 8000.0));
    printed(daemon.meissner().args(["play", "wave", "--seconds", "0.3", "--wait"]));

    let line = reload("lead_ms = 4\n");
    assert!(line.contains("`lead_ms` is 4") && line.contains("stays as it was"), "{line}");
    assert_eq!(status().lead_ms, 800.0);
    let line = reload("lead_ms = 800\nlease_ms = 8000\n[mock]\nseed = 7\n");
    assert!(line.contains("[mock] cannot change while the daemon runs"), "{line}");

    let other = daemon.path("other");
    daemon.write_config(&format!("patterns_dir = {other:?}\nlead_ms = 800\nlease_ms = 8000\n"));
    daemon.signal(Signal::HUP);
    daemon.wait_for_log("`patterns_dir`: ");
    let file = daemon.path("mine.toml");
    std::fs::write(
        &file,
        "format = 1\nname = \"mine\"\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 40.0\n",
    )
    .unwrap();
    printed(daemon.meissner().arg("import").arg(&file));
    assert!(daemon.path("patterns/mine.toml").exists(), "the old directory is still in use");
    std::fs::create_dir(&other).unwrap();
    daemon.signal(Signal::HUP);
    daemon.wait_for_log("`patterns_dir` at once");
    assert!(complaint(daemon.meissner().args(["show", "mine"])).contains("no pattern is called"));
    assert_eq!(status().state, "armed", "nothing of this ends what was armed");
}

#[test]
fn a_configuration_is_checked_without_a_daemon() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("m.toml");
    let check = || {
        let mut command = meissner();
        command.args(["daemon", "--check-config", "--config"]).arg(&file);
        command
    };
    std::fs::write(&file, "lead_ms = 50\n").unwrap();
    assert!(printed(&mut check()).ends_with("m.toml: valid\n"));
    for (text, says) in [
        ("laed_ms = 50\n", "m.toml:1: unknown key `laed_ms`"),
        ("patterns_dir = \"/nonexistent/patterns\"\n", "m.toml: `patterns_dir`: /nonexistent/patterns"),
        ("logbook_dir = \"/nonexistent/a/b\"\n", "m.toml: `logbook_dir`: /nonexistent/a/b: neither it nor"),
        (&format!("socket = \"/{}\"\n", "x".repeat(200)), "at most 101 bytes"),
        ("device = \"ua\\nrt\"\n", "`device` is `ua\\nrt`"),
        ("socket = \"/a\\u0000\"\n", "`socket` holds a control character"),
    ] {
        std::fs::write(&file, text).unwrap();
        let line = complaint(&mut check());
        assert!(line.contains(says), "{line}");
    }
}
