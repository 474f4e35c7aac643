//! A real daemon in a directory of its own, and helpers for the other tests.

use assert_cmd::Command;
use meissner_api::{Problem, Status};
use meissner_client::{Client, ClientError};
use serde_json::{Value, json};
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// For whatever must happen: far longer than it takes on a slow machine.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(20);

/// The program under test.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_meissner");

/// A real daemon on a simulated device, in a directory of its own. Dropping this ends both.
pub(crate) struct Daemon {
    child: Child,
    dir: TempDir,
}

impl Daemon {
    /// Starts one and waits for its device.
    pub(crate) fn start() -> Self {
        Self::on("mock")
    }

    /// Starts one on this device, with a long host watchdog timeout: a stall of a busy machine must not disarm it.
    pub(crate) fn on(device: &str) -> Self {
        Self::with(device, "lease_ms = 5000\n")
    }

    /// Starts one on this device, with these lines in its configuration.
    pub(crate) fn with(device: &str, config: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let log = File::create(dir.path().join("log")).unwrap();
        Self::spawn(dir, device, config, log.into())
    }

    /// Starts one whose log goes elsewhere.
    pub(crate) fn logging_to(stderr: impl Into<Stdio>) -> Self {
        let dir = tempfile::tempdir().unwrap();
        File::create(dir.path().join("log")).unwrap();
        Self::spawn(dir, "mock", "lease_ms = 5000\n", stderr.into())
    }

    /// Starts one on a device that does not answer.
    pub(crate) fn without_device(device: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let log = File::create(dir.path().join("log")).unwrap();
        Self::begin(dir, device, "", log.into())
    }

    fn spawn(dir: TempDir, device: &str, config: &str, stderr: Stdio) -> Self {
        let mut daemon = Self::begin(dir, device, config, stderr);
        daemon.wait_for_device();
        daemon
    }

    /// Starts one by another command, to which the daemon's arguments are appended.
    pub(crate) fn by(command: std::process::Command) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let log = File::create(dir.path().join("log")).unwrap();
        Self::launch(dir, "mock", "lease_ms = 5000\n", log.into(), command)
    }

    fn begin(dir: TempDir, device: &str, config: &str, stderr: Stdio) -> Self {
        let mut command = std::process::Command::new(PROGRAM);
        command.stdin(Stdio::null());
        Self::launch(dir, device, config, stderr, command)
    }

    fn launch(
        dir: TempDir,
        device: &str,
        config: &str,
        stderr: Stdio,
        mut command: std::process::Command,
    ) -> Self {
        fs::create_dir(dir.path().join("patterns")).unwrap();
        write_config(dir.path(), config);
        let child = command
            .args(["daemon", "--device", device, "--config"])
            .arg(dir.path().join("meissner.toml"))
            .env("MEISSNER_SOCKET", dir.path().join("m.sock"))
            .env_remove("RUST_LOG")
            .stdout(Stdio::null())
            .stderr(stderr)
            .spawn()
            .unwrap();
        Self { child, dir }
    }

    /// Waits until its log contains this, and returns the log.
    pub(crate) fn wait_for_log(&self, what: &str) -> String {
        let begun = Instant::now();
        loop {
            let log = self.log();
            if log.contains(what) {
                return log;
            }
            assert!(begun.elapsed() < TIMEOUT, "no `{what}`:\n{log}");
            thread::sleep(Duration::from_millis(10));
        }
    }

    pub(crate) fn wait_for_device(&mut self) {
        let mut client = self.client();
        let begun = Instant::now();
        while !client.get::<Status>("/v1/status").is_ok_and(|status| status.is_connected()) {
            let ended = self.child.try_wait().unwrap();
            assert!(ended.is_none() && begun.elapsed() < TIMEOUT, "no device ({ended:?}):\n{}", self.log());
            thread::sleep(Duration::from_millis(10));
        }
    }

    /// Replaces its configuration, without telling it.
    pub(crate) fn write_config(&self, config: &str) {
        write_config(self.dir.path(), config);
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub(crate) fn socket(&self) -> PathBuf {
        self.path("m.sock")
    }

    pub(crate) fn log(&self) -> String {
        fs::read_to_string(self.path("log")).unwrap()
    }

    pub(crate) fn client(&self) -> Client {
        Client::new(&self.socket()).unwrap()
    }

    /// A client of an armed daemon.
    pub(crate) fn armed(&self) -> Client {
        let mut client = self.client();
        let _: Status = client.post("/v1/arm", &json!({"assume_rest": true})).unwrap();
        client
    }

    /// The command line, connected to this daemon.
    pub(crate) fn meissner(&self) -> Command {
        let mut command = meissner();
        command.env("MEISSNER_SOCKET", self.socket()).current_dir(self.dir.path());
        command
    }

    /// Sends a request that closes the connection, and reads the answer.
    pub(crate) fn raw(&self, bytes: &[u8]) -> String {
        let mut stream = UnixStream::connect(self.socket()).unwrap();
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        stream.write_all(bytes).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    pub(crate) fn signal(&self, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(pid, signal).unwrap();
    }

    /// Waits until it has ended.
    pub(crate) fn wait(&mut self) -> ExitStatus {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(begun.elapsed() < TIMEOUT, "it does not end:\n{}", self.log());
            thread::sleep(Duration::from_millis(10));
        }
    }
}

fn write_config(dir: &Path, config: &str) {
    let text = format!("patterns_dir = {:?}\n{config}", dir.join("patterns"));
    fs::write(dir.join("meissner.toml"), text).unwrap();
}

impl Drop for Daemon {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
        if thread::panicking() {
            eprintln!("the daemon's log:\n{}", fs::read_to_string(self.path("log")).unwrap_or_default());
        }
    }
}

/// The command line, without a daemon.
pub(crate) fn meissner() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meissner"));
    command.env_remove("RUST_LOG").env("MEISSNER_SOCKET", "/nonexistent/m.sock").timeout(TIMEOUT);
    command
}

/// What a command said when it failed: exit 1 and one line on stderr.
pub(crate) fn complaint(command: &mut Command) -> String {
    let output = command.assert().failure().code(1).get_output().clone();
    let line = String::from_utf8(output.stderr).unwrap();
    assert!(line.starts_with("meissner: ") && line.trim_end().lines().count() == 1, "{line}");
    assert!(output.stdout.is_empty(), "{:?}", output.stdout);
    line
}

/// What a command printed when it succeeded.
pub(crate) fn printed(command: &mut Command) -> String {
    String::from_utf8(command.assert().success().get_output().stdout.clone()).unwrap()
}

/// The one document a command printed when it succeeded.
pub(crate) fn document(command: &mut Command) -> Value {
    serde_json::from_str(&printed(command)).unwrap()
}

/// The problem that a call returned.
pub(crate) fn problem(answer: Result<Value, ClientError>) -> Problem {
    match answer {
        Err(ClientError::Problem(problem)) => {
            assert!(!problem.detail.contains('\n') && !problem.detail.is_empty());
            problem
        }
        other => panic!("{other:?}"),
    }
}

/// `planned = played + late + dropped + refused`, and something was planned.
pub(crate) fn assert_accounts(receipt: &Value) {
    let of = |fate: &str| receipt["bursts"][fate].as_u64().unwrap();
    assert_eq!(of("planned"), of("played") + of("late") + of("dropped") + of("refused"), "{receipt}");
    assert!(of("planned") > 0, "{receipt}");
}

/// Writes a pattern file.
pub(crate) fn write_pattern(path: &Path, name: &str, drives: &str) {
    fs::write(path, format!("format = 1\nname = \"{name}\"\n{drives}")).unwrap();
}
