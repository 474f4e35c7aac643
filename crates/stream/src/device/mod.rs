//! Devices: whatever a controller can be reached through. A closed set, so an enum.
//!
//! Opening may block and is done by an ordinary thread; reading and writing never block. A board has a serial port
//! and an interface of its own, with the same frames on both; which one is plugged in, `find` says at every open.
//! The mock is a real backend: the same controller code as the firmware's, with the plant for shafts. `pty` puts it
//! behind a real pseudo-terminal and comes back through the serial port. A device that is gone says so by an error,
//! once.

pub mod find;
pub mod mock;
pub mod priority;
mod pty;
mod serial;
mod spec;
mod usb;

use crate::device::find::BoardQuery;
use crate::device::mock::{Mock, TruePositions};
use crate::link::LineRate;
use crate::time::HostInstant;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::PlantConfig;
use meissner_array::units::duration_to_ticks;
pub use pty::PtyMock;
use rustix::fd::BorrowedFd;
pub use serial::SerialPort;
pub use spec::{Spec, SpecError};
use std::fmt;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use usb::FULL_SPEED;
pub use usb::{UsbPort, watch};

/// The ids of a Pico that waits for a firmware.
const BARE_PICO: &str = "2e8a:0003";

/// Why a device could not be opened. It is shown on one line: what was found, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// The port does not exist.
    NotThere(PathBuf),
    /// No access.
    Denied(PathBuf),
    /// Another program has it.
    InUse(PathBuf),
    /// Something else has this name.
    NotSerial(PathBuf),
    /// Anything else about a port.
    Port(PathBuf, #[source] io::Error),
    /// No board with a serial port.
    NoSerial(String),
    /// No board with an interface of its own.
    NoUsb(String),
    /// Neither.
    NoBoard(String),
    /// No access.
    UsbDenied(String),
    /// Another program has it.
    UsbInUse(String),
    /// Another firmware.
    UsbInterface(String),
    /// Anything else about it.
    Usb(String, #[source] rusb::Error),
    /// No threads or descriptors for its transfers.
    UsbThreads(String, #[source] io::Error),
    /// No pseudo-terminal.
    Pty(#[source] io::Error),
    /// The mock's settings.
    Plant(#[from] meissner_array::simulated::PlantError),
}

impl DeviceError {
    /// What was found, and where.
    #[must_use]
    pub fn found(&self) -> String {
        let port = |path: &PathBuf, what: &str| format!("serial port {}: {what}", path.display());
        let usb = |place: &String, what: &str| format!("USB device {place}: {what}");
        match self {
            Self::NotThere(path) => port(path, "not there"),
            Self::Denied(path) => port(path, "permission denied"),
            Self::InUse(path) => port(path, "in use by another program"),
            Self::NotSerial(path) => port(path, "not a serial port"),
            Self::Port(path, error) => port(path, &error.to_string()),
            Self::NoSerial(sought) => format!("no board with a serial port: looked for {sought}"),
            Self::NoUsb(sought) => format!("no board on USB: looked for {sought}"),
            Self::NoBoard(sought) => format!("no board: looked for {sought}, by serial port and on USB"),
            Self::UsbDenied(place) => usb(place, "permission denied"),
            Self::UsbInUse(place) => usb(place, "in use by another program"),
            Self::UsbInterface(place) => usb(place, "it has no vendor-specific interface"),
            Self::Usb(place, error) => usb(place, &error.to_string()),
            Self::UsbThreads(place, error) => {
                usb(place, &format!("the system gives no thread for it: {error}"))
            }
            Self::Pty(error) => format!("no pseudo-terminal for the mock: {error}"),
            Self::Plant(error) => error.to_string(),
        }
    }

    /// What to do.
    #[must_use]
    pub fn advice(&self) -> String {
        let (vendor, product) = find::BOARD;
        let look = format!(
            "see `lsusb -d {vendor:04x}:{product:04x}` ({BARE_PICO} is a Pico without this firmware)"
        );
        match self {
            Self::NotThere(_) => "plug the board in, or see `ls /dev/serial/by-id`".to_owned(),
            Self::Denied(_) => "join the group that owns it (`haptics`, or `dialout` without our udev rules) and log in \
                                again"
                .to_owned(),
            Self::InUse(_) | Self::UsbInUse(_) => "stop that one first; a daemon says what it has in `meissner \
                                                   status`, one at another socket in `meissner status --socket PATH`"
                .to_owned(),
            Self::NotSerial(_) => "name one of `ls /dev/serial/by-id`".to_owned(),
            Self::Port(..) | Self::Usb(..) => "plug it in again, or see what `dmesg` says of it".to_owned(),
            Self::NoSerial(_) => "plug it in, or name a port with serial:PATH".to_owned(),
            Self::NoUsb(_) => format!("plug it in, or {look}"),
            Self::NoBoard(_) => format!("plug it in, or {look}, or use the simulated one, `mock`"),
            Self::UsbDenied(_) => "install deploy/70-meissner.rules and plug it in again".to_owned(),
            Self::UsbInterface(_) => "update its firmware, or use its serial port".to_owned(),
            Self::UsbThreads(..) | Self::Pty(_) => "see this machine's limits (`ulimit -a`)".to_owned(),
            Self::Plant(_) => "see the configuration's [mock]".to_owned(),
        }
    }
}

impl fmt::Display for DeviceError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}; {}", self.found(), self.advice())
    }
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
        self.mock.run(Tick::BOOT + duration_to_ticks(now.since(self.started)));
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
    /// A board on its own interface.
    Usb(UsbPort),
}

/// Opens a device. Blocks for as long as the system takes: not for the streamer's thread.
///
/// # Errors
/// One line that says what could not be opened and what to do.
pub fn open(spec: &Spec, plant: &PlantConfig) -> Result<Device, DeviceError> {
    let mock = || Ok(Device::Mock(Box::new(WallMock::new(plant, HostInstant::now())?)));
    match spec {
        Spec::Auto => match board() {
            // A board that is there and cannot be opened is no reason to play on something else.
            Err(DeviceError::NoBoard(_)) => mock(),
            other => other,
        },
        Spec::Board => board(),
        Spec::Mock => mock(),
        Spec::Pty => {
            let mock = PtyMock::spawn(WallMock::new(plant, HostInstant::now())?)?;
            let port = SerialPort::open(mock.path())?;
            Ok(Device::Pty(port, mock))
        }
        Spec::Serial(path) => Ok(Device::Serial(SerialPort::open(path)?)),
        Spec::Found(wanted) => Ok(Device::Serial(serial(wanted)?)),
        Spec::Usb(wanted) => Ok(Device::Usb(UsbPort::open(wanted)?)),
    }
}

fn serial(wanted: &BoardQuery) -> Result<SerialPort, DeviceError> {
    let port = find::port(wanted, &find::ports());
    SerialPort::open(&port.ok_or_else(|| DeviceError::NoSerial(wanted.to_string()))?)
}

/// The first board's serial port, else its own interface.
fn board() -> Result<Device, DeviceError> {
    let wanted = BoardQuery::default();
    match serial(&wanted) {
        Ok(port) => Ok(Device::Serial(port)),
        Err(DeviceError::NoSerial(_)) => match UsbPort::open(&wanted) {
            Ok(port) => Ok(Device::Usb(port)),
            Err(DeviceError::NoUsb(sought)) => Err(DeviceError::NoBoard(sought)),
            Err(error) => Err(error),
        },
        Err(error) => Err(error),
    }
}

/// Whether a board's serial port is there, whoever has it open.
#[must_use]
pub fn is_plugged(wanted: &BoardQuery) -> bool {
    find::port(wanted, &find::ports()).is_some()
}

impl Device {
    /// What it is, for people: `mock`, `pty:PATH`, `serial:PATH`, `usb:SERIAL`.
    #[must_use]
    pub fn kind(&self) -> String {
        match self {
            Self::Mock(_) => "mock".to_owned(),
            Self::Pty(port, _) => format!("pty:{}", port.path().display()),
            Self::Serial(port) => format!("serial:{}", port.path().display()),
            Self::Usb(port) => format!("usb:{}", port.serial()),
        }
    }

    /// The speed of its line.
    #[must_use]
    pub fn rate(&self) -> LineRate {
        match self {
            // As if it were on USB.
            Self::Mock(_) => FULL_SPEED,
            Self::Pty(port, _) | Self::Serial(port) => port.rate(),
            Self::Usb(port) => port.rate(),
        }
    }

    /// Readable when there are bytes; `None` for the mock, whose time is made by reading it.
    #[must_use]
    pub fn wake(&self) -> Option<BorrowedFd<'_>> {
        match self {
            Self::Mock(_) => None,
            Self::Pty(port, _) | Self::Serial(port) => Some(port.wake()),
            Self::Usb(port) => Some(port.wake()),
        }
    }

    /// Whether [`Self::wake`] is watched for being writable when bytes wait; if not, it turns readable for room, too.
    #[must_use]
    pub fn polls_writable(&self) -> bool {
        !matches!(self, Self::Usb(_))
    }

    /// The board's serial number, if it has one.
    #[must_use]
    pub fn serial_number(&self) -> Option<&str> {
        match self {
            Self::Mock(_) | Self::Pty(..) => None,
            Self::Serial(port) => port.serial(),
            Self::Usb(port) => Some(port.serial()).filter(|serial| !serial.is_empty()),
        }
    }

    /// Whose motors it drives, as far as that can be told: a board's serial number, else the port it is at; of a
    /// simulated array its seed and settings. The same through any port, and after any restart.
    #[must_use]
    pub fn identity(&self) -> String {
        match (self, self.serial_number()) {
            (Self::Mock(mock), _) => mock.mock.identity(),
            (Self::Pty(_, mock), _) => mock.identity().to_owned(),
            (_, Some(serial)) => format!("serial number {serial}"),
            (_, None) => format!("at {}", self.kind()),
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
            Self::Usb(port) => port.read(bytes),
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
            Self::Usb(port) => port.write(bytes),
        }
    }

    /// What the simulated shafts really did.
    #[must_use]
    pub fn true_positions(&self) -> Option<Arc<TruePositions>> {
        match self {
            Self::Mock(mock) => Some(mock.mock.true_positions()),
            Self::Pty(_, mock) => Some(mock.true_positions()),
            Self::Serial(_) | Self::Usb(_) => None,
        }
    }
}
