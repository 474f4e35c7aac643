//! A real daemon in its own directory, and helpers for the other tests.

use assert_cmd::Command;
use assert_cmd::assert::OutputAssertExt;
use meissner_api::{Event, Problem, Receipt, SessionList, Status};
use meissner_client::{Client, ClientError, Events};
use rustix::process::{Pid, Resource, Rlimit, Signal, getrlimit, kill_process, prlimit};
use serde_json::{Value, json};
use std::env;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{self, Child, ExitStatus, Output, Stdio};
use std::sync::{Arc, Once};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Longest wait for an event that must happen: far longer than it takes on a slow machine.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(300);

/// A configuration with which a stall of a busy machine neither makes strokes late nor disarms the motors: nearly the longest lead. With
/// a longer one, the line of the mock carries no live object.
pub(crate) const PATIENT: &str = "lead_ms = 900\nlease_ms = 10000\n";

/// The highest limits of a participant, for tests that are not about them.
pub(crate) const NOBODY: &str =
    "[participant]\nmax_amplitude_um = 400\nmax_continuous_s = 86400\nmax_day_s = 86400\n";

/// The program under test.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_meissner");

/// A real daemon on a simulated device, in its own directory. Dropping it kills it.
pub(crate) struct Daemon {
    child: Child,
    dir: Arc<TempDir>,
}

impl Daemon {
    /// Starts one and waits for its device.
    pub(crate) fn start() -> Self {
        Self::on("mock")
    }

    /// Starts one on this device, with a long host watchdog timeout: a stall of a busy machine must not disarm it.
    pub(crate) fn on(device: &str) -> Self {
        Self::with(device, PATIENT)
    }

    /// Starts one on this device with this configuration.
    pub(crate) fn with(device: &str, config: &str) -> Self {
        let dir = directory();
        let log = log_file(&dir);
        let mut daemon = Self::launch(dir, device, config, log, program());
        daemon.wait_for_device();
        daemon
    }

    /// Starts one whose log goes elsewhere.
    pub(crate) fn logging_to(stderr: impl Into<Stdio>) -> Self {
        let dir = directory();
        drop(log_file(&dir));
        let mut daemon = Self::launch(dir, "mock", PATIENT, stderr, program());
        daemon.wait_for_device();
        daemon
    }

    /// Starts one on a device that does not answer.
    pub(crate) fn without_device(device: &str) -> Self {
        let dir = directory();
        let log = log_file(&dir);
        Self::launch(dir, device, "", log, program())
    }

    /// Starts one through another command, to which the daemon's arguments are appended.
    pub(crate) fn by(command: process::Command) -> Self {
        let dir = directory();
        let log = log_file(&dir);
        Self::launch(dir, "mock", PATIENT, log, command)
    }

    /// Starts another one in this one's directory, and waits for its device.
    pub(crate) fn again(&self) -> Self {
        let mut daemon = Self::in_dir(&self.dir, PATIENT);
        daemon.wait_for_device();
        daemon
    }

    /// Starts one in a directory that others use before and after it.
    pub(crate) fn in_dir(dir: &Arc<TempDir>, config: &str) -> Self {
        Self::launch(Arc::clone(dir), "mock", config, log_file(dir), program())
    }

    /// Starts one in a directory that another one may have used.
    pub(crate) fn launch(
        dir: Arc<TempDir>,
        device: &str,
        config: &str,
        stderr: impl Into<Stdio>,
        mut command: process::Command,
    ) -> Self {
        enter_session();
        fs::create_dir_all(dir.path().join("patterns")).unwrap();
        write_config(dir.path(), config);
        let child = command
            .args(["daemon", "--device", device, "--config"])
            .arg(dir.path().join("meissner.toml"))
            .env("MEISSNER_SOCKET", dir.path().join("m.sock"))
            .env_remove("RUST_LOG")
            .env_remove("STATE_DIRECTORY")
            .env("XDG_STATE_HOME", dir.path().join("state"))
            .stdout(Stdio::null())
            .stderr(stderr)
            .spawn()
            .unwrap();
        Self { child, dir }
    }

    /// Waits until its log contains this, and returns the log.
    pub(crate) fn wait_for_log(&self, what: &str) -> String {
        wait_until(|| self.log().contains(what));
        self.log()
    }

    pub(crate) fn wait_for_device(&mut self) {
        let mut client = self.client();
        wait_until(|| {
            assert_eq!(self.child.try_wait().unwrap(), None, "the daemon has ended");
            client.get::<Status>("/v1/status").is_ok_and(|status| status.is_connected())
        });
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
        let mut client = Client::new(&self.socket()).unwrap();
        client.set_patience(TIMEOUT);
        client
    }

    /// A client of an armed daemon. A board on a machine that stands still does not answer in time: it is asked again.
    pub(crate) fn armed(&self) -> Client {
        let mut client = self.client();
        wait_until(|| match client.post::<Status>("/v1/arm", &json!({"assume_rest": true})) {
            Ok(_) => true,
            Err(ClientError::Problem(problem)) if ["timeout", "no-device"].contains(&&*problem.code) => false,
            Err(error) => panic!("{error}"),
        });
        client
    }

    /// The command line, connected to this daemon.
    pub(crate) fn meissner(&self) -> Command {
        let mut command = meissner();
        command.env("MEISSNER_SOCKET", self.socket()).env("XDG_RUNTIME_DIR", self.dir.path());
        command.current_dir(self.dir.path());
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

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Limits the size of its files to `bytes`, as on a full disk; `None` removes the limit.
    pub(crate) fn limit_files(&self, bytes: Option<u64>) {
        let pid = Some(Pid::from_child(&self.child));
        // The hard limit stays, so this needs no rights.
        let maximum = getrlimit(Resource::Fsize).maximum;
        prlimit(pid, Resource::Fsize, Rlimit { current: bytes.or(maximum), maximum }).unwrap();
    }

    /// Waits until it has ended.
    pub(crate) fn wait(&mut self) -> ExitStatus {
        let mut ended = None;
        wait_until(|| {
            ended = self.child.try_wait().unwrap();
            ended.is_some()
        });
        ended.unwrap()
    }

    /// Waits until the session record has all that has happened.
    pub(crate) fn wait_for_record(&self) {
        let _: SessionList = self.client().get("/v1/sessions").unwrap();
    }

    /// Ends it with SIGTERM.
    pub(crate) fn end(&mut self) -> ExitStatus {
        self.signal(Signal::TERM);
        self.wait()
    }
}

/// The patterns are in the daemon's directory, unless the configuration says where they are.
fn write_config(dir: &Path, config: &str) {
    let own = format!("patterns_dir = {:?}\n", dir.join("patterns"));
    let own = if config.contains("patterns_dir") { "" } else { &own };
    fs::write(dir.join("meissner.toml"), format!("{own}{config}")).unwrap();
}

/// A directory for daemons.
pub(crate) fn directory() -> Arc<TempDir> {
    Arc::new(tempfile::tempdir().unwrap())
}

fn log_file(dir: &TempDir) -> File {
    File::create(dir.path().join("log")).unwrap()
}

fn program() -> process::Command {
    let mut command = process::Command::new(PROGRAM);
    command.stdin(Stdio::null());
    command
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
    let mut command = Command::new(PROGRAM);
    command.env_remove("RUST_LOG").env("MEISSNER_SOCKET", "/nonexistent/m.sock").timeout(TIMEOUT);
    // A daemon that a test starts by mistake writes nowhere.
    command.env("XDG_STATE_HOME", "/nonexistent").env_remove("MEISSNER_SESSION_TOKEN");
    command
}

/// Starts a process session if this process has none that its container knows, as under some CI services: the daemon takes commands
/// without one for those of several terminals.
fn enter_session() {
    static ENTERED: Once = Once::new();
    ENTERED.call_once(|| {
        if nix::unistd::getsid(None).unwrap().as_raw() == 0 {
            nix::unistd::setsid().unwrap();
        }
    });
}

/// A command line that runs in this process: for commands that need neither a daemon nor an environment.
pub(crate) struct Offline(Vec<OsString>);

pub(crate) fn offline() -> Offline {
    Offline(vec!["meissner".into()])
}

impl Offline {
    pub(crate) fn arg(&mut self, argument: impl AsRef<OsStr>) -> &mut Self {
        self.args([argument])
    }

    pub(crate) fn args<A: AsRef<OsStr>>(&mut self, arguments: impl IntoIterator<Item = A>) -> &mut Self {
        self.0.extend(arguments.into_iter().map(|argument| argument.as_ref().to_owned()));
        self
    }
}

/// A command line that a test can run.
pub(crate) trait Run {
    fn run(&mut self) -> Output;
}

impl Run for Command {
    fn run(&mut self) -> Output {
        self.output().unwrap()
    }
}

impl Run for Offline {
    fn run(&mut self) -> Output {
        meissner::cli::answered(&self.0)
    }
}

/// Waits until something has happened.
#[track_caller]
pub(crate) fn wait_until(mut happened: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !happened() {
        assert!(begun.elapsed() < TIMEOUT, "it has not happened in {TIMEOUT:?}");
        thread::sleep(Duration::from_millis(5));
    }
}

/// Waits for the next event for which `wanted` returns a value, and returns that value.
#[track_caller]
pub(crate) fn next<T>(events: &mut Events, wanted: impl Fn(Event) -> Option<T>) -> T {
    loop {
        let event = events.next(Some(TIMEOUT)).unwrap().expect("the stream goes on");
        if let Some(found) = wanted(event) {
            return found;
        }
    }
}

/// The receipt of the next play that ends.
#[track_caller]
pub(crate) fn ended(events: &mut Events) -> Receipt {
    next(events, |event| match event {
        Event::Ended { receipt } => Some(*receipt),
        _ => None,
    })
}

/// The play that begins next.
#[track_caller]
pub(crate) fn began(events: &mut Events) -> u64 {
    next(events, |event| match event {
        Event::Began { id, .. } => Some(id),
        _ => None,
    })
}

/// The message of a command that fails: exit 1 and one line on stderr.
pub(crate) fn complaint(command: &mut impl Run) -> String {
    let output = command.run().assert().failure().code(1).get_output().clone();
    let line = String::from_utf8(output.stderr).unwrap();
    assert!(line.starts_with("meissner: ") && line.trim_end().lines().count() == 1, "{line}");
    assert!(output.stdout.is_empty(), "{:?}", output.stdout);
    line
}

/// The output of a command that succeeds.
pub(crate) fn printed(command: &mut impl Run) -> String {
    String::from_utf8(command.run().assert().success().get_output().stdout.clone()).unwrap()
}

/// The JSON document that a command prints.
pub(crate) fn document(command: &mut impl Run) -> Value {
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

/// The code and HTTP status of the problem that a call returned.
pub(crate) fn refusal(answer: Result<Value, ClientError>) -> (String, u16) {
    let problem = problem(answer);
    (problem.code, problem.status)
}

/// Writes a pattern file.
pub(crate) fn write_pattern(path: &Path, name: &str, drives: &str) {
    fs::write(path, format!("format = 1\nname = \"{name}\"\n{drives}")).unwrap();
}
