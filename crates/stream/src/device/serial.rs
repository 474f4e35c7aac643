//! A serial port: `serialport` opens and sets it up, then it is read and written without blocking.
//!
//! `find` says which port is the board's. The program's only `unsafe` is here: copying the port's descriptor.

use crate::device::error::DeviceError;
use crate::device::find;
use crate::device::usb::EStopLine;
use crate::link::LineRate;
use rustix::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl, open};
use rustix::io::Errno;
use rustix::termios::{ioctl_tiocexcl, isatty};
use serialport::SerialPort as _;
use std::io;
use std::path::{Path, PathBuf};

/// Baud. A board's USB CDC port ignores the rate; a real UART needs at least this for the strokes.
const BAUD: u32 = 1_000_000;
/// Start bit, eight bits, stop bit.
const BITS_PER_BYTE: u32 = 10;
/// How the names of ports without a UART begin: USB CDC, pseudo-terminals.
const NO_UART: [&str; 2] = ["/dev/ttyACM", "/dev/pts/"];

/// Whether the path names something else than a terminal. Called for a path that could not be opened as a port.
fn is_no_terminal(path: &Path) -> bool {
    let flags = OFlags::RDONLY | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    open(path, flags, Mode::empty()).is_ok_and(|fd| !isatty(fd))
}

/// An open port.
#[derive(Debug)]
pub struct SerialPort {
    fd: OwnedFd,
    path: PathBuf,
    rate: LineRate,
    serial: Option<String>,
    /// The e-stop line to the board behind the port, if there is a board and this user may open it.
    e_stop: Option<EStopLine>,
}

impl SerialPort {
    /// Opens a port for this process alone. Exclusive mode refuses other users' programs; a lock refuses programs that ask for
    /// it, root's too.
    ///
    /// # Errors
    /// If the port does not exist, is closed to this user, or is in use.
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
                    _ if is_no_terminal(path) => DeviceError::NotSerial(owned),
                    _ => DeviceError::Port(owned, error.into()),
                });
            }
        };
        // A board takes this line as "a host is connected"; a pseudo-terminal has no such line.
        let _ = port.write_data_terminal_ready(true);
        let failed = |error| DeviceError::Port(owned.clone(), error);
        // SAFETY: the port holds its descriptor open until it is dropped, after the copy is made.
        let borrowed = unsafe { BorrowedFd::borrow_raw(port.as_raw_fd()) };
        // A copy: `into_raw_fd` would leak the port's name.
        let fd = borrowed.try_clone_to_owned().map_err(failed)?;
        // Its close ends the exclusive mode of the terminal, also for the copy.
        drop(port);
        ioctl_tiocexcl(&fd).map_err(|error| failed(error.into()))?;
        let nonblocking = fcntl_getfl(&fd).and_then(|flags| fcntl_setfl(&fd, flags | OFlags::NONBLOCK));
        nonblocking.map_err(|error| failed(error.into()))?;
        let name = path.canonicalize().unwrap_or_else(|_| owned.clone());
        let uart = !NO_UART.iter().any(|start| name.to_string_lossy().starts_with(start));
        let rate = if uart { LineRate(BAUD / BITS_PER_BYTE) } else { LineRate::USB_FULL_SPEED };
        let serial = find::serial_of(path, &find::ports());
        let e_stop = serial.as_deref().filter(|_| !uart).and_then(EStopLine::beside);
        Ok(Self { fd, path: owned, rate, serial, e_stop })
    }

    /// Its path, as it was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The serial number of the USB device behind it, if it has one.
    pub fn serial(&self) -> Option<&str> {
        self.serial.as_deref()
    }

    pub(super) fn e_stop(&self, epoch: u16) {
        if let Some(line) = &self.e_stop {
            line.request(epoch);
        }
    }

    /// Its nominal rate.
    pub(super) fn rate(&self) -> LineRate {
        self.rate
    }

    pub(super) fn wake(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }

    pub(super) fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match rustix::io::read(&self.fd, bytes) {
            // A terminal that hung up reads as its end.
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
