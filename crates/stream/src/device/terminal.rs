//! A pseudo-terminal, seen from its far end.
//!
//! Invariant: it is raw before a program opens it, and reads and writes at the far end do not wait.

use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::io;
use std::path::{Path, PathBuf};

/// The far end of a pseudo-terminal. Dropping it hangs up.
#[derive(Debug)]
pub struct Terminal {
    master: OwnedFd,
    path: PathBuf,
}

/// What the far end reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// So many bytes.
    Bytes(usize),
    /// A program has the terminal open, and no byte waits.
    Nothing,
    /// No program has it open.
    Closed,
}

impl Terminal {
    /// Opens one.
    ///
    /// # Errors
    /// If the system gives none.
    pub fn open() -> io::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name = ptsname(&master, Vec::new())?;
        let path = PathBuf::from(name.to_string_lossy().into_owned());
        // Raw before a program opens it: the controller would read an echo as frames.
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let slave = rustix::fs::open(&path, flags, Mode::empty())?;
        let mut settings = tcgetattr(&slave)?;
        settings.make_raw();
        tcsetattr(&slave, OptionalActions::Now, &settings)?;
        drop(slave);
        let flags = rustix::fs::fcntl_getfl(&master)?;
        rustix::fs::fcntl_setfl(&master, flags | OFlags::NONBLOCK)?;
        Ok(Self { master, path })
    }

    /// What a program opens as a serial port.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads what the program has written.
    pub fn read(&self, bytes: &mut [u8]) -> Received {
        match rustix::io::read(&self.master, bytes) {
            Ok(len) if len > 0 => Received::Bytes(len),
            Err(Errno::AGAIN) => Received::Nothing,
            _ => Received::Closed,
        }
    }

    /// Writes for the program to read; returns how many bytes had room.
    pub fn write(&self, bytes: &[u8]) -> usize {
        rustix::io::write(&self.master, bytes).unwrap_or(0)
    }
}

impl AsFd for Terminal {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.master.as_fd()
    }
}
