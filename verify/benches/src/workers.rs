//! Real-time priority for the kernel's workers that move bytes through a pseudo-terminal.
//!
//! They have ordinary priority and compete with every program: under some hundred busy threads a byte waits in them for up to 0.9
//! s, in both directions. Bytes to a USB device need no worker; bytes from a serial port need one. A benchmark that measures the
//! daemon, and not this path, therefore raises the workers' priority.

use rustix::process::geteuid;
use std::fs;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// See the module. Dropping it gives the workers their ordinary priority again; a benchmark that is killed leaves them raised.
#[derive(Debug)]
pub struct Workers {
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Workers {
    /// Raises the priority of the present workers and of later ones. Returns none if the user is not root, or without the command
    /// `chrt`.
    pub fn raise() -> Option<Self> {
        if !geteuid().is_root() || !chrt(&["--version"]) {
            return None;
        }
        let over = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&over);
        let thread = thread::spawn(move || {
            let mut raised = Vec::new();
            while !ended.load(Ordering::Relaxed) {
                for pid in unbound().into_iter().filter(|pid| !raised.contains(pid)).collect::<Vec<_>>() {
                    // The worker may have ended meanwhile.
                    chrt(&["--fifo", "--pid", "60", &pid]);
                    raised.push(pid);
                }
                thread::sleep(Duration::from_millis(200));
            }
            for pid in unbound().iter().filter(|pid| raised.contains(pid)) {
                chrt(&["--other", "--pid", "0", pid]);
            }
        });
        Some(Self { over, thread: Some(thread) })
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn chrt(arguments: &[&str]) -> bool {
    let mut command = Command::new("chrt");
    command.args(arguments).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// The workers that are bound to no processor.
fn unbound() -> Vec<String> {
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let is_worker = |entry: &fs::DirEntry| {
        fs::read_to_string(entry.path().join("comm")).is_ok_and(|comm| comm.starts_with("kworker/u"))
    };
    processes.filter(is_worker).filter_map(|entry| entry.file_name().into_string().ok()).collect()
}
