//! The mock behind a pseudo-terminal: a thread that runs it in wall time at the terminal's far end.
//!
//! To the serial transport it is a board: closing the port is pulling the cable. The thread ends when the
//! [`PtyMock`] is dropped.

use crate::device::mock::TruePositions;
use crate::device::{DeviceError, WallMock};
use crate::time::HostInstant;
use firmware_protocol::message::State;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fd::OwnedFd;
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;

/// How often a terminal that nobody has open is looked at.
const HUNG_UP_MS: i64 = 5;

/// A running mock behind a terminal.
#[derive(Debug)]
pub struct PtyMock {
    path: PathBuf,
    stop: Arc<OwnedFd>,
    truth: Arc<TruePositions>,
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
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name = ptsname(&master, Vec::new())?;
        let path = PathBuf::from(name.to_string_lossy().into_owned());
        // Raw before anybody opens it: an echo would come back to the controller as frames.
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let slave = rustix::fs::open(&path, flags, Mode::empty())?;
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        drop(slave);
        let flags = rustix::fs::fcntl_getfl(&master)?;
        rustix::fs::fcntl_setfl(&master, flags | OFlags::NONBLOCK)?;
        let stop = Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?);
        let (truth, identity) = (mock.mock.true_positions(), mock.mock.identity());
        let bell = Arc::clone(&stop);
        let thread =
            std::thread::Builder::new().name("pty-mock".into()).spawn(move || serve(mock, &master, &bell))?;
        Ok(Self { path, stop, truth, identity, thread: Some(thread) })
    }

    /// The terminal to open.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Ends the thread and gives the mock back as it stands: `None` if the thread has panicked.
    #[must_use]
    pub fn into_mock(mut self) -> Option<WallMock> {
        self.end()
    }

    fn end(&mut self) -> Option<WallMock> {
        let _ = rustix::io::write(&self.stop, &1u64.to_ne_bytes());
        self.thread.take()?.join().ok()
    }

    /// Which array it is.
    #[must_use]
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// What the shafts really did.
    #[must_use]
    pub fn true_positions(&self) -> Arc<TruePositions> {
        Arc::clone(&self.truth)
    }
}

impl Drop for PtyMock {
    fn drop(&mut self) {
        self.end();
    }
}

fn serve(mut mock: WallMock, master: &OwnedFd, stop: &OwnedFd) -> WallMock {
    let (mut bytes, mut unsent) = ([0; 4096], 0..0);
    let mut outgoing = [0; 4096];
    let mut plugged = false;
    loop {
        let controller = mock.mock.controller();
        let quiet = matches!(controller.state(), State::Disarmed | State::Faulted) && unsent.is_empty();
        let wait_ms = if !plugged {
            HUNG_UP_MS
        } else if quiet {
            1000
        } else {
            1
        };
        let timeout = Timespec { tv_sec: wait_ms / 1000, tv_nsec: wait_ms % 1000 * 1_000_000 };
        // A terminal that nobody has open is always "ready": then only the bell is waited for.
        let mut ready = [PollFd::new(stop, PollFlags::IN), PollFd::new(master, PollFlags::IN)];
        let watched = if plugged { 2 } else { 1 };
        let _ = poll(&mut ready[..watched], Some(&timeout));
        if !ready[0].revents().is_empty() {
            return mock;
        }
        loop {
            match rustix::io::read(master, &mut bytes) {
                Ok(len) if len > 0 => {
                    plugged = true;
                    mock.mock.write(&bytes[..len]);
                }
                Err(rustix::io::Errno::AGAIN) => {
                    plugged = true;
                    break;
                }
                _ => {
                    if std::mem::take(&mut plugged) {
                        mock.mock.unplug();
                    }
                    unsent = 0..0;
                    break;
                }
            }
        }
        // Also when nobody reads: the controller must notice that it hears nothing.
        mock.run(HostInstant::now());
        loop {
            if unsent.is_empty() {
                unsent = 0..mock.mock.read(&mut outgoing);
            }
            if unsent.is_empty() || !plugged {
                break;
            }
            match rustix::io::write(master, &outgoing[unsent.clone()]) {
                Ok(len) => unsent.start += len,
                Err(_) => break,
            }
        }
    }
}
