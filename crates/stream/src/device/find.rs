//! Finds the board among the USB devices that are plugged in.
//!
//! A [`BoardQuery`] matches by USB ids, by product string (our ids are pid.codes' test ids, which others use too), and by
//! serial number if one is given. Look a board up at every open: after a re-plug its port may have another name.
//!
//! Invariant: nothing here opens a device.

use meissner_input::message::escape;
use serialport::{SerialPortInfo, SerialPortType};
use std::fmt;
use std::path::{Path, PathBuf};

/// A board's USB ids: pid.codes' test ids, until it has its own.
pub const BOARD: (u16, u16) = (0x1209, 0x0001);
/// Its product string.
pub const PRODUCT: &str = "meissner";
/// `serialport` panics where this is missing: a system without terminals, or without `/sys`.
const TTYS: &str = "/sys/class/tty";

/// Which board to look for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BoardQuery {
    /// USB vendor and product.
    pub ids: (u16, u16),
    /// Its serial number; any board if `None`.
    pub serial: Option<String>,
}

impl Default for BoardQuery {
    /// Any board.
    fn default() -> Self {
        Self { ids: BOARD, serial: None }
    }
}

impl BoardQuery {
    /// The board with this serial number.
    pub fn serial(serial: &str) -> Self {
        Self { ids: BOARD, serial: Some(serial.to_owned()) }
    }

    /// Parses `SERIAL`, `VID:PID` or `VID:PID:SERIAL`, ids as four hex digits; `None` if it is none of them.
    pub(super) fn parse(text: &str) -> Option<Self> {
        let id = |text: &str| u16::from_str_radix(text, 16).ok().filter(|_| text.len() == 4);
        let mut parts = text.splitn(3, ':');
        let query = match (parts.next()?, parts.next(), parts.next()) {
            (serial, None, _) => Self::serial(serial),
            (vendor, Some(product), serial) => {
                Self { ids: (id(vendor)?, id(product)?), serial: serial.map(str::to_owned) }
            }
        };
        let printable =
            |serial: &String| !serial.is_empty() && serial.bytes().all(|byte| byte.is_ascii_graphic());
        query.serial.as_ref().is_none_or(printable).then_some(query)
    }

    /// Whether a device with these descriptors matches.
    pub fn matches(&self, ids: (u16, u16), product: Option<&str>, serial: Option<&str>) -> bool {
        let named = self.ids != BOARD || product == Some(PRODUCT);
        let serial_fits = |wanted: &str| serial.is_some_and(|serial| serial.eq_ignore_ascii_case(wanted));
        ids == self.ids && named && self.serial.as_deref().is_none_or(serial_fits)
    }
}

impl fmt::Display for BoardQuery {
    /// What was looked for, for people.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "USB {:04x}:{:04x}", self.ids.0, self.ids.1)?;
        if self.ids == BOARD {
            write!(out, " `{PRODUCT}`")?;
        }
        self.serial.as_ref().map_or(Ok(()), |serial| write!(out, ", serial number {serial}"))
    }
}

/// All serial ports, with their USB descriptors. Works without libudev: `serialport` reads `/sys`.
pub(super) fn ports() -> Vec<SerialPortInfo> {
    if Path::new(TTYS).is_dir() { serialport::available_ports().unwrap_or_default() } else { Vec::new() }
}

/// The first of these ports, by name, that matches.
pub(super) fn port(query: &BoardQuery, ports: &[SerialPortInfo]) -> Option<PathBuf> {
    let matches = |port: &&SerialPortInfo| match &port.port_type {
        SerialPortType::UsbPort(usb) => {
            query.matches((usb.vid, usb.pid), usb.product.as_deref(), usb.serial_number.as_deref())
        }
        _ => false,
    };
    let first = ports.iter().filter(matches).min_by_key(|port| (port.port_name.len(), &port.port_name));
    first.map(|port| PathBuf::from(&port.port_name))
}

/// The serial number of the USB device behind a port, if it has one, escaped: the device may send any text.
pub(super) fn serial_of(path: &Path, ports: &[SerialPortInfo]) -> Option<String> {
    let path = path.canonicalize().ok()?;
    let port = ports.iter().find(|port| Path::new(&port.port_name) == path)?;
    match &port.port_type {
        SerialPortType::UsbPort(usb) => usb.serial_number.as_deref().map(escape),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serialport::UsbPortInfo;

    fn usb(name: &str, ids: (u16, u16), product: &str, serial: Option<&str>) -> SerialPortInfo {
        let usb = UsbPortInfo {
            vid: ids.0,
            pid: ids.1,
            serial_number: serial.map(str::to_owned),
            manufacturer: None,
            product: Some(product.to_owned()),
            interface: Some(0),
        };
        SerialPortInfo { port_name: name.to_owned(), port_type: SerialPortType::UsbPort(usb) }
    }

    #[test]
    fn a_serial_number_is_plain_text() {
        let path = std::env::current_exe().unwrap();
        let ports = [usb(path.to_str().unwrap(), BOARD, PRODUCT, Some("e6\n\u{1b}[2J\u{202e}"))];
        assert_eq!(serial_of(&path, &ports).unwrap(), r"e6\n\u{1b}[2J\u{202e}");
    }

    #[test]
    fn a_board_is_found_among_other_devices() {
        let ports = [
            SerialPortInfo { port_name: "/dev/ttyS0".into(), port_type: SerialPortType::Unknown },
            usb("/dev/ttyACM0", BOARD, "blinky", Some("1")),
            usb("/dev/ttyUSB0", (0x1a86, 0x7523), "bridge", None),
            usb("/dev/ttyACM10", BOARD, "meissner", Some("e66038b7")),
            usb("/dev/ttyACM2", BOARD, "meissner", Some("aa")),
        ];
        let found = |text: &str| port(&BoardQuery::parse(text).unwrap(), &ports);
        assert_eq!(port(&BoardQuery::default(), &ports), Some("/dev/ttyACM2".into()), "the first by name");
        assert_eq!(found("E66038B7"), Some("/dev/ttyACM10".into()));
        assert_eq!(found("1209:0001:e66038b7"), Some("/dev/ttyACM10".into()));
        assert_eq!(found("1a86:7523"), Some("/dev/ttyUSB0".into()), "other ids need no name");
        assert_eq!(found("1"), None, "another device has this serial number");
        assert_eq!(found("bb"), None);
    }

    #[test]
    fn the_udev_rules_name_the_same_board() {
        let rules = include_str!("../../../../deploy/70-meissner.rules");
        for rule in rules.lines().filter(|line| line.starts_with("SUBSYSTEM")) {
            for part in [
                format!("{{idVendor}}==\"{:04x}\"", BOARD.0),
                format!("{{idProduct}}==\"{:04x}\"", BOARD.1),
                format!("{{product}}==\"{PRODUCT}\""),
            ] {
                assert!(rule.contains(&part), "{part}: {rule}");
            }
        }
        assert_eq!(rules.matches("SUBSYSTEM").count(), 3);
    }
}
