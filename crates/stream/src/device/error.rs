//! Why a device could not be opened: what was found, where, and what to do, on one line.

use crate::device::find;
use std::fmt;
use std::io;
use std::path::PathBuf;

/// The USB ids of a Pico that waits for firmware.
const BARE_PICO: &str = "2e8a:0003";

/// A device that could not be opened. Ports carry their path, USB devices their place (`bus/address`).
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// The port does not exist.
    NotThere(PathBuf),
    /// This user may not open the port.
    Denied(PathBuf),
    /// Another program has the port open.
    InUse(PathBuf),
    /// The path names something else than a serial port.
    NotSerial(PathBuf),
    /// Any other problem with a port.
    Port(PathBuf, #[source] io::Error),
    /// No board with a serial port is plugged in.
    NoSerial(String),
    /// No board with its own USB interface is plugged in.
    NoUsb(String),
    /// No board of either kind is plugged in.
    NoBoard(String),
    /// This user may not open the USB device.
    UsbDenied(String),
    /// Another program has claimed the USB device.
    UsbInUse(String),
    /// The board runs another firmware.
    UsbInterface(String),
    /// Any other problem with a USB device.
    Usb(String, #[source] rusb::Error),
    /// The system gave no threads or descriptors for its transfers.
    UsbThreads(String, #[source] io::Error),
    /// The system gave no pseudo-terminal.
    Pty(#[source] io::Error),
    /// The settings of the simulated motors are out of range.
    Motors(#[from] meissner_array::simulated::SimulatedMotorsError),
}

impl DeviceError {
    /// What was found, and where.
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
                usb(place, &format!("the system gave no thread for it: {error}"))
            }
            Self::Pty(error) => format!("no pseudo-terminal for the mock: {error}"),
            Self::Motors(error) => error.to_string(),
        }
    }

    /// What to do.
    pub fn advice(&self) -> String {
        let (vendor, product) = find::BOARD;
        let look = format!(
            "see `lsusb -d {vendor:04x}:{product:04x}` ({BARE_PICO} is a Pico without this firmware)"
        );
        match self {
            Self::NotThere(_) => "plug the board in, or see `ls /dev/serial/by-id`".to_owned(),
            Self::Denied(_) => "join the group that owns the port (`haptics`, or `dialout` without our udev rules) and \
                                log in again"
                .to_owned(),
            Self::InUse(_) | Self::UsbInUse(_) => "stop that program first: `sudo fuser -v FILE` names it; `meissner status` shows the device of a \
                                                   daemon, `meissner status --socket PATH` that of one at another socket"
                .to_owned(),
            Self::NotSerial(_) => "name a port from `ls /dev/serial/by-id`".to_owned(),
            Self::Port(..) | Self::Usb(..) => "plug it in again, or see what `dmesg` says about it".to_owned(),
            Self::NoSerial(_) => "plug the board in, or name a port with serial:PATH".to_owned(),
            Self::NoUsb(_) => format!("plug the board in, or {look}"),
            Self::NoBoard(_) => format!("plug the board in, or {look}, or use the simulated one, `mock`"),
            Self::UsbDenied(_) => "install deploy/70-meissner.rules and plug the board in again".to_owned(),
            Self::UsbInterface(_) => "update its firmware, or use its serial port".to_owned(),
            Self::UsbThreads(..) | Self::Pty(_) => "check this machine's limits (`ulimit -a`)".to_owned(),
            Self::Motors(_) => "check [mock] in the configuration".to_owned(),
        }
    }
}

impl fmt::Display for DeviceError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}; {}", self.found(), self.advice())
    }
}
