//! Devices: whatever a controller can be reached through. A closed set, so an enum.
//!
//! placeholder

pub mod mock;

use std::path::PathBuf;
use std::str::FromStr;

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

/// An open device.
#[derive(Debug)]
pub enum Device {}

impl Device {
    /// How it is reached: `mock`, `pty`, `serial`.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match *self {}
    }

    /// The simulated plant's truth, if it is simulated in this process.
    #[must_use]
    pub fn truth(&self) -> Option<std::sync::Arc<mock::Truth>> {
        match *self {}
    }
}

/// Why a device could not be opened.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct DeviceError(pub String);

/// Opens a device. Blocks for as long as the system takes: not for the streamer's thread.
///
/// # Errors
/// One line that says what could not be opened and what to do.
pub fn open(_spec: &Spec, _plant: &crate::plant::PlantConfig) -> Result<Device, DeviceError> {
    Err(DeviceError(String::new()))
}
