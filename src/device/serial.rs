//! A serial port: opened and set up by `serialport`, then read and written without blocking.
//!
//! It does not look for boards. The only `unsafe` of the program is here: taking over the descriptor.

use crate::device::DeviceError;
use crate::link::LineRate;
use rustix::fd::{AsFd, BorrowedFd, FromRawFd, IntoRawFd, OwnedFd};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use serialport::SerialPort as _;
use std::io;
use std::path::{Path, PathBuf};

/// A board's USB CDC port ignores the rate; a true UART needs at least this for the stream.
const BAUD: u32 = 1_000_000;
/// Start bit, eight bits, stop bit.
const BITS_PER_BYTE: u32 = 10;

/// An open port.
#[derive(Debug)]
pub struct SerialPort {
    fd: OwnedFd,
    path: PathBuf,
}

impl SerialPort {
    /// Opens a port for this process alone.
    ///
    /// # Errors
    /// If it is not there, not ours, or in use.
    pub fn open(path: &Path) -> Result<Self, DeviceError> {
        let owned = path.to_owned();
        let mut port = match serialport::new(path.to_string_lossy(), BAUD).open_native() {
            Ok(port) => port,
            Err(error) if !path.exists() => {
                drop(error);
                return Err(DeviceError::NotThere(owned));
            }
            Err(error) => {
                return Err(match error.kind() {
                    serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied) => DeviceError::Denied(owned),
                    // A port locked by another process reads as this.
                    serialport::ErrorKind::NoDevice => DeviceError::InUse(owned),
                    _ => DeviceError::Port(owned, error.into()),
                });
            }
        };
        // Boards take it as "the host is there"; a pseudo-terminal has no such line.
        let _ = port.write_data_terminal_ready(true);
        let raw = port.into_raw_fd();
        // SAFETY: `into_raw_fd` gave up the descriptor, which is open and now owned here alone.
        let fd = unsafe { OwnedFd::from_raw_fd(raw) };
        let nonblocking = fcntl_getfl(&fd).and_then(|flags| fcntl_setfl(&fd, flags | OFlags::NONBLOCK));
        nonblocking.map_err(|error| DeviceError::Port(owned.clone(), error.into()))?;
        Ok(Self { fd, path: owned })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn rate(&self) -> LineRate {
        LineRate(BAUD / BITS_PER_BYTE)
    }

    pub(super) fn wake(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }

    pub(super) fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match rustix::io::read(&self.fd, bytes) {
            // The end of a terminal is its hang-up.
            Ok(0) => Err(io::ErrorKind::BrokenPipe.into()),
            Err(Errno::AGAIN | Errno::INTR) => Ok(0),
            other => Ok(other?),
        }
    }

    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match rustix::io::write(&self.fd, bytes) {
            Err(Errno::AGAIN | Errno::INTR) => Ok(0),
            other => Ok(other?),
        }
    }
}
