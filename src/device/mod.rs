//! Devices: whatever a controller can be reached through. A closed set, so an enum.
//!
//! Opening may block and is done by an ordinary thread; reading and writing never block. The mock is a real
//! backend: the same controller code as the firmware's, with the plant for shafts. `pty` puts it behind a real
//! pseudo-terminal and comes back through the serial port. A device that is gone says so by an error, once.

pub mod mock;
mod pty;
mod serial;

use crate::device::mock::{Mock, Truth};
use crate::link::LineRate;
use crate::plant::PlantConfig;
use crate::units::HostInstant;
use firmware_protocol::tick::{TICK_HZ, Tick};
pub use pty::PtyMock;
use rustix::fd::BorrowedFd;
pub use serial::SerialPort;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

/// Which device to use, as given on the command line or in the configuration.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Spec {
    /// The first board found, else the mock.
    #[default]
    Auto,
    /// Controller and plant in this process, in wall time.
    Mock,
    /// The mock behind a pseudo-terminal, reached as a serial port.
    Pty,
    /// A serial port by its path.
    Serial(PathBuf),
}

/// Not a device.
#[derive(Debug, thiserror::Error)]
#[error("device `{0}`: not one of auto, mock, pty, serial:PATH")]
pub struct BadSpec(String);

impl FromStr for Spec {
    type Err = BadSpec;
    fn from_str(text: &str) -> Result<Self, BadSpec> {
        match text.split_once(':') {
            None if text == "auto" => Ok(Self::Auto),
            None if text == "mock" => Ok(Self::Mock),
            None if text == "pty" => Ok(Self::Pty),
            Some(("serial", path)) if !path.is_empty() => Ok(Self::Serial(path.into())),
            _ => Err(BadSpec(text.to_owned())),
        }
    }
}

impl std::fmt::Display for Spec {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => out.write_str("auto"),
            Self::Mock => out.write_str("mock"),
            Self::Pty => out.write_str("pty"),
            Self::Serial(path) => write!(out, "serial:{}", path.display()),
        }
    }
}

/// Why a device could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// The port does not exist.
    #[error("serial port {0}: not there; plug the board in, or see `ls /dev/serial/by-id`")]
    NotThere(PathBuf),
    /// No access.
    #[error(
        "serial port {0}: permission denied; join the group that owns it (often `dialout`) and log in again"
    )]
    Denied(PathBuf),
    /// Another program has it.
    #[error("serial port {0}: in use by another program; stop that one first")]
    InUse(PathBuf),
    /// Anything else about a port.
    #[error("serial port {0}: {1}")]
    Port(PathBuf, #[source] io::Error),
    /// No pseudo-terminal.
    #[error("no pseudo-terminal for the mock: {0}")]
    Pty(#[source] io::Error),
    /// The mock's settings.
    #[error("mock: {0}")]
    Plant(#[from] crate::plant::PlantError),
}

/// The mock, run by the wall clock of whoever reads it.
#[derive(Debug)]
pub struct WallMock {
    mock: Mock,
    /// When its clock stood at [`Tick::BOOT`].
    started: HostInstant,
}

impl WallMock {
    /// A mock that boots at `now`.
    ///
    /// # Errors
    /// If the plant's settings are out of range.
    pub fn new(plant: &PlantConfig, now: HostInstant) -> Result<Self, DeviceError> {
        let boot = RandomState::new().build_hasher().finish() as u32;
        Ok(Self { mock: Mock::new(*plant, boot)?, started: now })
    }

    /// The mock itself.
    pub fn mock(&mut self) -> &mut Mock {
        &mut self.mock
    }

    /// Takes in what was written and runs up to `now`.
    fn run(&mut self, now: HostInstant) {
        let ns = now.since(self.started).as_nanos() as u64;
        let ticks = u128::from(ns) * u128::from(TICK_HZ) / 1_000_000_000;
        self.mock.run(Tick::BOOT + ticks as u64);
    }
}

/// An open device.
#[derive(Debug)]
pub enum Device {
    /// Controller and plant in this process.
    Mock(Box<WallMock>),
    /// The mock behind a pseudo-terminal.
    Pty(SerialPort, PtyMock),
    /// A board on a serial port.
    Serial(SerialPort),
}

/// Opens a device. Blocks for as long as the system takes: not for the streamer's thread.
///
/// # Errors
/// One line that says what could not be opened and what to do.
pub fn open(spec: &Spec, plant: &PlantConfig) -> Result<Device, DeviceError> {
    match spec {
        // Boards are looked for from the firmware issue on; until then there is none to be found.
        Spec::Auto | Spec::Mock => Ok(Device::Mock(Box::new(WallMock::new(plant, HostInstant::now())?))),
        Spec::Pty => {
            let mock = PtyMock::spawn(WallMock::new(plant, HostInstant::now())?)?;
            let port = SerialPort::open(mock.path())?;
            Ok(Device::Pty(port, mock))
        }
        Spec::Serial(path) => Ok(Device::Serial(SerialPort::open(path)?)),
    }
}

impl Device {
    /// What it is, for people: `mock`, `pty:PATH`, `serial:PATH`.
    #[must_use]
    pub fn kind(&self) -> String {
        match self {
            Self::Mock(_) => "mock".to_owned(),
            Self::Pty(port, _) => format!("pty:{}", port.path().display()),
            Self::Serial(port) => format!("serial:{}", port.path().display()),
        }
    }

    /// The speed of its line.
    #[must_use]
    pub fn rate(&self) -> LineRate {
        match self {
            // A full-speed USB CDC device takes 0.8 MB/s.
            Self::Mock(_) => LineRate(800_000),
            Self::Pty(port, _) | Self::Serial(port) => port.rate(),
        }
    }

    /// Readable when there are bytes; `None` for the mock, whose time is made by reading it.
    #[must_use]
    pub fn wake(&self) -> Option<BorrowedFd<'_>> {
        match self {
            Self::Mock(_) => None,
            Self::Pty(port, _) | Self::Serial(port) => Some(port.wake()),
        }
    }

    /// Takes what is there: 0 if there is nothing.
    ///
    /// # Errors
    /// The device is gone.
    pub fn read(&mut self, now: HostInstant, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Mock(mock) => {
                mock.run(now);
                Ok(mock.mock.read(bytes))
            }
            Self::Pty(port, _) | Self::Serial(port) => port.read(bytes),
        }
    }

    /// Hands over as much as there is room for.
    ///
    /// # Errors
    /// The device is gone.
    pub fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Mock(mock) => Ok(mock.mock.write(bytes)),
            Self::Pty(port, _) | Self::Serial(port) => port.write(bytes),
        }
    }

    /// What the simulated shafts really did.
    #[must_use]
    pub fn truth(&self) -> Option<Arc<Truth>> {
        match self {
            Self::Mock(mock) => Some(mock.mock.truth()),
            Self::Pty(_, mock) => Some(mock.truth()),
            Self::Serial(_) => None,
        }
    }
}
