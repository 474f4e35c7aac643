//! The names of devices on the command line and in the configuration: `auto`, `mock...`, `pty`, `serial...`, `usb...`.
//!
//! A [`Spec`] is parsed from its name and displays as that name.

use crate::device::find::BoardQuery;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// Which device to use.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Spec {
    /// The first board found, else the mock.
    #[default]
    Auto,
    /// The first board found. `auto` becomes this once it has found a board; it cannot be written.
    Board,
    /// Controller and simulated motors in this process, in wall time.
    Mock,
    /// The mock as a board is: without telemetry, on a line as fast as USB; with a lower stop or without one.
    MockBoard {
        /// Whether the array has a lower stop.
        lower_stop: bool,
    },
    /// The mock behind a pseudo-terminal, reached as a serial port.
    Pty,
    /// A serial port by its path.
    Serial(PathBuf),
    /// A board's serial port.
    Found(BoardQuery),
    /// A board's own USB interface.
    Usb(BoardQuery),
}

/// Text that names no device. The caller adds the text itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// It begins like no device's name.
    #[error(
        "not one of auto, mock, mock:board, mock:board,lower-stop, pty, serial, serial:PATH, serial:SERIAL, serial:VID:PID[:SERIAL], usb, usb:SERIAL"
    )]
    Unknown,
    /// `serial:` with malformed ids.
    #[error(
        "ids have four hex digits each, as in serial:1209:0001; a path has a slash, as in serial:/dev/ttyACM0"
    )]
    Ids,
    /// `usb:` with ids.
    #[error("usb takes a serial number only, as in usb:E66038B7; for other ids write serial:VID:PID")]
    UsbIds,
}

impl Spec {
    /// The board to wait for, if it may appear when somebody plugs it in.
    pub fn board(&self) -> Option<BoardQuery> {
        match self {
            Self::Auto | Self::Board => Some(BoardQuery::default()),
            Self::Found(wanted) | Self::Usb(wanted) => Some(wanted.clone()),
            Self::Mock | Self::MockBoard { .. } | Self::Pty | Self::Serial(_) => None,
        }
    }
}

impl FromStr for Spec {
    type Err = SpecError;
    fn from_str(text: &str) -> Result<Self, SpecError> {
        match text.split_once(':') {
            None if text == "auto" => Ok(Self::Auto),
            None if text == "mock" => Ok(Self::Mock),
            Some(("mock", "board")) => Ok(Self::MockBoard { lower_stop: false }),
            Some(("mock", "board,lower-stop")) => Ok(Self::MockBoard { lower_stop: true }),
            None if text == "pty" => Ok(Self::Pty),
            None if text == "serial" => Ok(Self::Found(BoardQuery::default())),
            None if text == "usb" => Ok(Self::Usb(BoardQuery::default())),
            Some(("serial", path)) if path.contains('/') => Ok(Self::Serial(path.into())),
            Some(("serial", board)) => {
                let bad = if board.contains(':') { SpecError::Ids } else { SpecError::Unknown };
                BoardQuery::parse(board).map(Self::Found).ok_or(bad)
            }
            Some(("usb", serial)) if serial.contains(':') => Err(SpecError::UsbIds),
            Some(("usb", serial)) => BoardQuery::parse(serial).map(Self::Usb).ok_or(SpecError::Unknown),
            _ => Err(SpecError::Unknown),
        }
    }
}

impl fmt::Display for Spec {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let with = |out: &mut fmt::Formatter<'_>, name: &str, serial: &Option<String>| match serial {
            Some(serial) => write!(out, "{name}:{serial}"),
            None => out.write_str(name),
        };
        match self {
            Self::Auto | Self::Board => out.write_str("auto"),
            Self::Mock => out.write_str("mock"),
            Self::MockBoard { lower_stop: false } => out.write_str("mock:board"),
            Self::MockBoard { lower_stop: true } => out.write_str("mock:board,lower-stop"),
            Self::Pty => out.write_str("pty"),
            Self::Serial(path) => write!(out, "serial:{}", path.display()),
            Self::Found(wanted) if wanted.ids == BoardQuery::default().ids => {
                with(out, "serial", &wanted.serial)
            }
            Self::Found(BoardQuery { ids: (vendor, product), serial }) => {
                with(out, &format!("serial:{vendor:04x}:{product:04x}"), serial)
            }
            Self::Usb(wanted) => with(out, "usb", &wanted.serial),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_read_and_written_alike() {
        for text in [
            "auto",
            "mock",
            "mock:board",
            "mock:board,lower-stop",
            "pty",
            "serial",
            "serial:/dev/ttyACM0",
            "serial:./board",
            "serial:e66038b7",
            "serial:2e8a:000a",
            "serial:2e8a:000a:e6",
            "usb",
            "usb:e66038b7",
        ] {
            assert_eq!(text.parse::<Spec>().unwrap().to_string(), text);
        }
        let found = Spec::Found(BoardQuery::serial("e6"));
        assert_eq!("serial:1209:0001:e6".parse::<Spec>().unwrap(), found);
        for (text, bad) in [
            ("", SpecError::Unknown),
            ("uart", SpecError::Unknown),
            ("serial:", SpecError::Unknown),
            ("usb:", SpecError::Unknown),
            ("mock:1", SpecError::Unknown),
            ("mock:board,stop", SpecError::Unknown),
            ("board", SpecError::Unknown),
            ("serial:12:34", SpecError::Ids),
            ("serial:1209:1", SpecError::Ids),
            ("usb:1209:0001", SpecError::UsbIds),
        ] {
            assert_eq!(text.parse::<Spec>(), Err(bad), "{text}");
        }
        assert!(SpecError::Ids.to_string().contains("four hex digits"));
        assert!(SpecError::UsbIds.to_string().contains("a serial number only"));
    }
}
