//! A daemon on the simulated array, in its own process: `MEISSNER_PROGRAM`, or the `meissner` that `cargo build --release` made.

use meissner_api::Status;
use meissner_client::Client;
use std::error::Error;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use std::{env, fs, thread};
use tempfile::TempDir;

/// No participant feels what is played.
const NOBODY: &str = "[participant]\nmax_continuous_s = 86400\nmax_day_s = 86400\n";

/// A daemon, ended when it is dropped.
#[derive(Debug)]
pub struct Daemon {
    child: Child,
    dir: TempDir,
}

impl Daemon {
    /// Starts a daemon with this configuration, and waits for its device.
    ///
    /// # Errors
    /// If there is no such program, or the daemon does not answer.
    pub fn start(config: &str) -> Result<Self, Box<dyn Error>> {
        let text = config;
        let beside = || Ok::<PathBuf, std::io::Error>(env::current_exe()?.with_file_name("../meissner"));
        let program = env::var_os("MEISSNER_PROGRAM").map_or_else(beside, |path| Ok(path.into()))?;
        let dir = tempfile::tempdir()?;
        let patterns = dir.path().join("patterns");
        fs::create_dir(&patterns)?;
        let config = dir.path().join("meissner.toml");
        fs::write(&config, format!("patterns_dir = {patterns:?}\nlease_ms = 5000\n{text}{NOBODY}"))?;
        let child = Command::new(&program)
            .args(["daemon", "--no-record", "--device", "mock", "--config"])
            .arg(config)
            .arg("--socket")
            .arg(dir.path().join("m.sock"))
            .stderr(Stdio::null())
            .spawn()
            .map_err(|error| {
                format!("{}: {error}; set MEISSNER_PROGRAM, or `cargo build --release`", program.display())
            })?;
        let daemon = Self { child, dir };
        let begun = Instant::now();
        while !daemon.client()?.get::<Status>("/v1/status").is_ok_and(|status| status.is_connected()) {
            if begun.elapsed() > Duration::from_secs(10) {
                return Err("the daemon does not answer".into());
            }
            thread::sleep(Duration::from_millis(20));
        }
        Ok(daemon)
    }

    /// Its socket.
    pub fn socket(&self) -> PathBuf {
        self.dir.path().join("m.sock")
    }

    /// A client of it.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn client(&self) -> Result<Client, Box<dyn Error>> {
        Ok(Client::new(&self.socket())?)
    }

    /// Resident memory and its peak, MB.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn memory_mb(&self) -> Result<[u64; 2], Box<dyn Error>> {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id()))?;
        let kb = |key: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(key)).ok_or("no such figure")?;
            Ok::<u64, Box<dyn Error>>(line.trim_matches([':', ' ', '\t', 'k', 'B']).parse()?)
        };
        Ok([kb("VmRSS")? * 1024 / 1_000_000, kb("VmHWM")? * 1024 / 1_000_000])
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
