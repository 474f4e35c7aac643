//! The daemon under test: a process in a directory of its own.
//!
//! Invariant: it ends when the [`Daemon`] is dropped, or when the thread that started it ends, also if it is stopped.

use meissner_api::Status;
use meissner_client::Client;
use rustix::process::{Pid, Signal, kill_process};
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Ends its command when the thread that started it ends.
const SETPRIV: [&str; 3] = ["/usr/bin/setpriv", "--pdeathsig", "KILL"];
/// Gives its command the priority of an ordinary program, whatever the runner's is.
const CHRT: [&str; 3] = ["/usr/bin/chrt", "--other", "0"];
/// Longest wait for what must happen: far longer than it takes on a slow machine.
const TIMEOUT: Duration = Duration::from_secs(300);

pub(crate) struct Daemon {
    child: Child,
    dir: PathBuf,
}

impl Daemon {
    /// Starts one on this serial port. Its drift limit is too high to matter, so that a bad line or sensor does not end plays.
    pub(crate) fn start(program: &Path, dir: &Path, port: &Path) -> Self {
        let config = dir.join("meissner.toml");
        fs::create_dir_all(dir.join("patterns")).unwrap();
        let patterns = dir.join("patterns");
        fs::write(&config, format!("patterns_dir = {patterns:?}\ndrift_limit_um = 10000\n")).unwrap();
        let mut words: Vec<&OsStr> = Vec::new();
        for tool in [SETPRIV, CHRT] {
            // Both are part of any Linux distribution.
            assert!(Path::new(tool[0]).exists(), "{} is missing: install util-linux", tool[0]);
            words.extend(tool.map(OsStr::new));
        }
        let mut command = Command::new(words[0]);
        command.args(&words[1..]).arg(program);
        let child = command
            .args(["daemon", "--device", &format!("serial:{}", port.display()), "--config"])
            .arg(config)
            .env("MEISSNER_SOCKET", dir.join("m.sock"))
            .env_remove("RUST_LOG")
            .env_remove("STATE_DIRECTORY")
            .env("XDG_STATE_HOME", dir.join("state"))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::options().create(true).append(true).open(dir.join("log")).unwrap())
            .spawn()
            .unwrap();
        Self { child, dir: dir.to_owned() }
    }

    pub(crate) fn socket(&self) -> PathBuf {
        self.dir.join("m.sock")
    }

    pub(crate) fn client(&self) -> Client {
        Client::new(&self.socket()).unwrap()
    }

    pub(crate) fn log(&self) -> String {
        fs::read_to_string(self.dir.join("log")).unwrap_or_default()
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Kills it, and waits until it is gone.
    pub(crate) fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Waits until it has its device.
    pub(crate) fn wait_for_device(&self, client: &mut Client) -> Result<Status, String> {
        let begun = Instant::now();
        loop {
            match client.get_within::<Status>(Duration::from_secs(2), "/v1/status") {
                Ok(status) if status.is_connected() => return Ok(status),
                other if begun.elapsed() > TIMEOUT => {
                    return Err(format!("the daemon has no device: {other:?}; its log:\n{}", self.log()));
                }
                _ => sleep(Duration::from_millis(10)),
            }
        }
    }

    /// Its metrics, which are no JSON. `None` if it does not answer.
    pub(crate) fn metrics(&self, timeout: Duration) -> Option<String> {
        let mut stream = UnixStream::connect(self.socket()).ok()?;
        stream.set_read_timeout(Some(timeout)).ok()?;
        stream.write_all(b"GET /v1/metrics HTTP/1.1\r\nHost: m\r\nConnection: close\r\n\r\n").ok()?;
        let mut text = String::new();
        stream.read_to_string(&mut text).ok()?;
        Some(text)
    }
}

/// The sum of a family of metrics.
pub(crate) fn metric(text: &str, name: &str) -> u64 {
    let values = text.lines().filter_map(|line| {
        let (key, value) = line.rsplit_once(' ')?;
        let family = key.split('{').next()?;
        (family == name).then(|| value.parse::<f64>().ok()).flatten()
    });
    values.sum::<f64>() as u64
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.kill();
    }
}
