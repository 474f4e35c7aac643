//! The mock behind a pseudo-terminal: a thread runs it in wall time at the terminal's far end.
//!
//! Open [`PtyMock::path`] as a serial port: to that transport the mock is a board, and closing the port pulls the cable.
//!
//! Invariant: the thread ends when the [`PtyMock`] is dropped.

use crate::device::error::DeviceError;
use crate::device::mock::TruePositions;
use crate::device::terminal::{Received, Terminal};
use crate::device::wall_mock::WallMock;
use crate::time::HostInstant;
use firmware_protocol::message::State;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fd::OwnedFd;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;

/// How often the thread checks a terminal that no program has open.
const UNPLUGGED_MS: i64 = 5;

/// A running mock behind a terminal.
#[derive(Debug)]
pub struct PtyMock {
    path: PathBuf,
    stop: Arc<OwnedFd>,
    positions: Arc<TruePositions>,
    identity: String,
    thread: Option<JoinHandle<WallMock>>,
}

impl PtyMock {
    /// Starts the thread.
    ///
    /// # Errors
    /// If the system gives no pseudo-terminal.
    pub fn spawn(mock: WallMock) -> Result<Self, DeviceError> {
        Self::start(mock).map_err(DeviceError::Pty)
    }

    fn start(mock: WallMock) -> io::Result<Self> {
        let terminal = Terminal::open()?;
        let path = terminal.path().to_owned();
        let stop = Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?);
        let (positions, identity) = (mock.true_positions(), mock.identity());
        let stopped = Arc::clone(&stop);
        let thread = std::thread::Builder::new()
            .name("pty-mock".into())
            .spawn(move || serve(mock, &terminal, &stopped))?;
        Ok(Self { path, stop, positions, identity, thread: Some(thread) })
    }

    /// The terminal to open as a serial port.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Ends the thread and returns the mock in its current state; `None` if the thread panicked.
    pub fn into_mock(mut self) -> Option<WallMock> {
        self.end()
    }

    fn end(&mut self) -> Option<WallMock> {
        let _ = rustix::io::write(&self.stop, &1u64.to_ne_bytes());
        self.thread.take()?.join().ok()
    }

    /// Which simulated array it is: see [`WallMock::identity`].
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// Where its pins really are.
    pub fn true_positions(&self) -> Arc<TruePositions> {
        Arc::clone(&self.positions)
    }
}

impl Drop for PtyMock {
    fn drop(&mut self) {
        self.end();
    }
}

fn serve(mut mock: WallMock, terminal: &Terminal, stop: &OwnedFd) -> WallMock {
    let (mut bytes, mut unsent) = ([0; 4096], 0..0);
    let mut outgoing = [0; 4096];
    let mut plugged = false;
    loop {
        let controller = mock.mock().controller();
        let quiet = matches!(controller.state(), State::Disarmed | State::Faulted) && unsent.is_empty();
        let wait_ms = if !plugged {
            UNPLUGGED_MS
        } else if quiet {
            1000
        } else {
            1
        };
        let timeout = Timespec { tv_sec: wait_ms / 1000, tv_nsec: wait_ms % 1000 * 1_000_000 };
        // A terminal that no program has open is always "ready": then wait only for the stop event.
        let mut ready = [PollFd::new(stop, PollFlags::IN), PollFd::new(terminal, PollFlags::IN)];
        let watched = if plugged { 2 } else { 1 };
        let _ = poll(&mut ready[..watched], Some(&timeout));
        let ends = !ready[0].revents().is_empty();
        loop {
            match terminal.read(&mut bytes) {
                Received::Bytes(len) => {
                    plugged = true;
                    mock.mock().write(&bytes[..len]);
                }
                Received::Nothing => {
                    plugged = true;
                    break;
                }
                Received::Closed => {
                    if std::mem::take(&mut plugged) {
                        mock.mock().unplug();
                    }
                    unsent = 0..0;
                    break;
                }
            }
        }
        // Run even without new bytes: the controller's host watchdog must be able to time out.
        mock.run(HostInstant::now());
        if ends {
            return mock;
        }
        loop {
            if unsent.is_empty() {
                unsent = 0..mock.mock().read(&mut outgoing);
            }
            if unsent.is_empty() || !plugged {
                break;
            }
            match terminal.write(&outgoing[unsent.clone()]) {
                0 => break,
                len => unsent.start += len,
            }
        }
    }
}
