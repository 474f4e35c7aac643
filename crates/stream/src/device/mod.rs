//! Devices: everything through which the host can reach a controller.
//!
//! The set is closed, so [`Device`] is an enum. [`open`] blocks and runs on an ordinary thread; [`Device::read`] and
//! [`Device::write`] never block, so the streamer's thread calls them.
//!
//! | module | what it is | `--device` |
//! |---|---|---|
//! | `mock` | controller and simulated motors in this process, in virtual time | |
//! | `wall_mock` | the mock in wall time, also like a board on USB | `mock`, `mock:board` |
//! | `pty` | the mock behind a real pseudo-terminal | `pty` |
//! | `serial` | a board on a serial port | `serial...` |
//! | `usb` | a board on its own USB interface | `usb...` |
//!
//! The mock is a real backend: it runs the same controller code as the firmware. A board has a serial port and a USB
//! interface with the same frames on both. [`find`] looks at every open which one is plugged in, `spec` reads and
//! writes the names, `terminal` is a pseudo-terminal's far end, `error` says why a device could not be opened, and
//! [`priority`] gives a thread real-time priority.
//!
//! # To add a device
//! 1. Write a module with a type that opens the device, and reads and writes bytes without blocking. Report a device
//!    that is gone by an error.
//! 2. Add a variant to [`Device`]; the compiler then names each `match` that needs an arm: kind, rate, wake, serial
//!    number, identity, read, write.
//! 3. Add its name to [`Spec`] (parse and display are beside each other) and open it in [`open`].
//! 4. Add its errors to [`DeviceError`], each with what was found and what to do.
//!
//! Invariant: a device that is gone says so by an error, once; until then `read` and `write` return at once.

mod error;
pub mod find;
pub mod mock;
pub mod priority;
mod pty;
mod serial;
mod spec;
mod terminal;
mod usb;
mod wall_mock;

use crate::device::find::BoardQuery;
use crate::device::mock::TruePositions;
use crate::link::LineRate;
use crate::queues::{At, CommandError};
use crate::time::HostInstant;
pub use error::DeviceError;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
pub use pty::PtyMock;
use rustix::fd::BorrowedFd;
pub use serial::SerialPort;
pub use spec::{Spec, SpecError};
use std::io;
use std::sync::Arc;
pub use terminal::{Received, Terminal};
pub use usb::{UsbPort, watch};
pub use wall_mock::{Faults, WallMock};

/// An open device.
#[derive(Debug)]
pub enum Device {
    /// Controller and simulated motors in this process.
    Mock(Box<WallMock>),
    /// The mock behind a pseudo-terminal, reached as a serial port.
    Pty(SerialPort, PtyMock),
    /// A board on a serial port.
    Serial(SerialPort),
    /// A board on its own USB interface.
    Usb(UsbPort),
}

/// Opens a device; a simulated one has this array with these motors. It blocks as long as the system takes, so the streamer's thread
/// must not call it.
///
/// # Errors
/// If the device cannot be opened; the error's one line says why and what to do.
pub fn open(spec: &Spec, array: Array, motors: &SimulatedMotorsConfig) -> Result<Device, DeviceError> {
    let mock = || Ok(Device::Mock(Box::new(WallMock::new(array, motors, HostInstant::now())?)));
    match spec {
        Spec::Auto => match board() {
            // A board that is plugged in but cannot be opened must not be replaced by the mock silently.
            Err(DeviceError::NoBoard(_)) => mock(),
            other => other,
        },
        Spec::Board => board(),
        Spec::Mock => mock(),
        Spec::MockBoard { .. } => {
            Ok(Device::Mock(Box::new(WallMock::like_a_board(array, motors, HostInstant::now())?)))
        }
        Spec::Pty => {
            let mock = PtyMock::spawn(WallMock::new(array, motors, HostInstant::now())?)?;
            let port = SerialPort::open(mock.path())?;
            Ok(Device::Pty(port, mock))
        }
        Spec::Serial(path) => Ok(Device::Serial(SerialPort::open(path)?)),
        Spec::Found(wanted) => Ok(Device::Serial(serial(wanted)?)),
        Spec::Usb(wanted) => Ok(Device::Usb(UsbPort::open(wanted)?)),
    }
}

fn serial(query: &BoardQuery) -> Result<SerialPort, DeviceError> {
    let port = find::port(query, &find::ports());
    SerialPort::open(&port.ok_or_else(|| DeviceError::NoSerial(query.to_string()))?)
}

/// The first board: by its serial port, else by its own USB interface.
fn board() -> Result<Device, DeviceError> {
    let any = BoardQuery::default();
    match serial(&any) {
        Ok(port) => Ok(Device::Serial(port)),
        Err(DeviceError::NoSerial(_)) => match UsbPort::open(&any) {
            Ok(port) => Ok(Device::Usb(port)),
            Err(DeviceError::NoUsb(sought)) => Err(DeviceError::NoBoard(sought)),
            Err(error) => Err(error),
        },
        Err(error) => Err(error),
    }
}

/// Whether a board's serial port is there, even if another program has it open.
pub fn is_plugged(query: &BoardQuery) -> bool {
    find::port(query, &find::ports()).is_some()
}

impl Device {
    /// Its name for people: `mock`, `mock:board`, `pty:PATH`, `serial:PATH`, `usb:SERIAL`.
    pub fn kind(&self) -> String {
        match self {
            Self::Mock(mock) if mock.is_like_a_board() => "mock:board".to_owned(),
            Self::Mock(_) => "mock".to_owned(),
            Self::Pty(port, _) => format!("pty:{}", port.path().display()),
            Self::Serial(port) => format!("serial:{}", port.path().display()),
            Self::Usb(port) => format!("usb:{}", port.serial()),
        }
    }

    /// The nominal rate of its line.
    pub fn rate(&self) -> LineRate {
        match self {
            // As if it were on USB.
            Self::Mock(_) => LineRate::USB_FULL_SPEED,
            Self::Pty(port, _) | Self::Serial(port) => port.rate(),
            Self::Usb(port) => port.rate(),
        }
    }

    /// A descriptor that is readable when bytes wait; `None` for the mock, which runs only when it is read.
    pub fn wake(&self) -> Option<BorrowedFd<'_>> {
        match self {
            Self::Mock(_) => None,
            Self::Pty(port, _) | Self::Serial(port) => Some(port.wake()),
            Self::Usb(port) => Some(port.wake()),
        }
    }

    /// Whether to poll [`Self::wake`] for writing while bytes wait to be sent. If not, it turns readable when there is room.
    pub fn polls_writable(&self) -> bool {
        !matches!(self, Self::Usb(_))
    }

    /// The board's serial number, if it has one.
    pub fn serial_number(&self) -> Option<&str> {
        match self {
            Self::Mock(_) | Self::Pty(..) => None,
            Self::Serial(port) => port.serial(),
            Self::Usb(port) => Some(port.serial()).filter(|serial| !serial.is_empty()),
        }
    }

    /// Which motors it drives, as far as the host can know: a board's serial number, else its port; for simulated motors
    /// their seed and settings. It stays the same through any port and after any restart.
    pub fn identity(&self) -> String {
        match (self, self.serial_number()) {
            (Self::Mock(mock), _) => mock.identity(),
            (Self::Pty(_, mock), _) => mock.identity().to_owned(),
            (_, Some(serial)) => format!("serial number {serial}"),
            (_, None) => format!("at {}", self.kind()),
        }
    }

    /// Reads the bytes that wait; 0 if none do. Never blocks.
    ///
    /// # Errors
    /// If the device is gone.
    pub fn read(&mut self, now: HostInstant, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Mock(mock) => {
                mock.run(now);
                if mock.is_unplugged() {
                    Err(io::ErrorKind::NotConnected.into())
                } else {
                    Ok(mock.read(bytes))
                }
            }
            Self::Pty(port, _) | Self::Serial(port) => port.read(bytes),
            Self::Usb(port) => port.read(bytes),
        }
    }

    /// Writes as many bytes as there is room for and returns how many. Never blocks.
    ///
    /// # Errors
    /// If the device is gone.
    pub fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Mock(mock) => Ok(mock.write(bytes)),
            Self::Pty(port, _) | Self::Serial(port) => port.write(bytes),
            Self::Usb(port) => port.write(bytes),
        }
    }

    /// Asks a board on USB for an e-stop past the bytes that wait, if it can. Its frame must be written as well. Never blocks.
    pub fn e_stop(&mut self, epoch: u16) {
        match self {
            Self::Mock(_) | Self::Pty(..) => {}
            Self::Serial(port) => port.e_stop(epoch),
            Self::Usb(port) => port.e_stop(epoch),
        }
    }

    /// An edge of the trigger input of the mock comes: now ([`At::Next`]), at a tick, or after some time. Client `by` has ordered it.
    /// Never blocks.
    ///
    /// # Errors
    /// If it is no mock, if the edge is more than an hour ahead, or if there is no room for more edges to come.
    pub fn edge(&mut self, now: HostInstant, at: At, by: u64) -> Result<(), CommandError> {
        match self {
            Self::Mock(mock) => mock.edge(now, at, by),
            Self::Pty(..) | Self::Serial(_) | Self::Usb(_) => Err(CommandError::NotSimulated),
        }
    }

    /// Forgets the edges to come that this client has ordered.
    pub fn withdraw_edges(&mut self, by: u64) {
        if let Self::Mock(mock) = self {
            mock.withdraw_edges(by);
        }
    }

    /// Where the simulated pins really are; `None` for a board.
    pub fn true_positions(&self) -> Option<Arc<TruePositions>> {
        match self {
            Self::Mock(mock) => Some(mock.true_positions()),
            Self::Pty(_, mock) => Some(mock.true_positions()),
            Self::Serial(_) | Self::Usb(_) => None,
        }
    }
}
