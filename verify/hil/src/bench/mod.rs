//! The firmware in an emulated chip. Time passes on it only in [`chip::ChipBench::run`].

pub mod answer;
pub mod chip;

use std::path::PathBuf;

/// A USB function of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Function {
    /// The tty.
    #[default]
    Cdc,
    /// The vendor interface.
    Bulk,
}

impl Function {
    /// The emulator's name for it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cdc => "cdc",
            Self::Bulk => "bulk",
        }
    }

    /// The other one.
    pub const fn other(self) -> Self {
        match self {
            Self::Cdc => Self::Bulk,
            Self::Bulk => Self::Cdc,
        }
    }
}

/// A failure of the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CpuEvent {
    /// It stops executing.
    Die,
    /// The firmware panics.
    Panic,
    /// A hard fault.
    Hardfault,
    /// The RUN pin goes low for a moment.
    Run,
}

/// Bytes from the device.
#[derive(Clone, Debug, Default)]
pub struct Heard {
    /// From the tty.
    pub cdc: Vec<u8>,
    /// From the vendor interface.
    pub bulk: Vec<u8>,
}

/// Why there is no bench, or it ended.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The firmware was not built.
    #[error("{0}: no firmware there; build it (`firmware/build`) or set MEISSNER_FIRMWARE_ELF")]
    NoFirmware(PathBuf),
    /// The emulator is not installed.
    #[error("{0}: no emulator there; install it (`npm ci` in verify/emulator/)")]
    NoEmulator(PathBuf),
    /// Node does not start.
    #[error("`node` cannot be started ({0}); install Node.js 20 or newer")]
    NoNode(#[source] std::io::Error),
    /// The emulator's answer.
    #[error(transparent)]
    Answer(#[from] answer::AnswerError),
}
