//! The device that the host is connected to: the mock, or the firmware in an emulated chip.
//!
//! Both run in lock-step on the cycles of [`crate::time`]. Time passes on them only in [`Bench::run`].

pub mod answer;
pub mod chip;
mod device;
pub mod mock;

use crate::pins::Pins;
use chip::{ChipBench, ChipOptions};
pub use device::{BenchError, CpuEvent, Function, Heard};
use firmware_protocol::urgent::e_stop_request;
use mock::MockBench;

/// A device on the bench.
#[derive(Debug)]
pub enum Bench {
    /// The library's mock.
    Mock(MockBench),
    /// The emulated chip.
    Chip(ChipBench),
}

/// Which bench to build.
#[derive(Clone, Debug)]
pub enum Which {
    /// The mock, with this seed.
    Mock(u64),
    /// The chip.
    Chip(ChipOptions),
}

impl Bench {
    /// Powers one up.
    ///
    /// # Errors
    /// If the chip's emulator or firmware is missing.
    pub fn start(which: &Which) -> Result<Self, BenchError> {
        match which {
            Which::Mock(seed) => MockBench::start(*seed).map(Self::Mock),
            Which::Chip(options) => ChipBench::start(options).map(Self::Chip),
        }
    }

    /// Its clock.
    #[must_use]
    pub fn cycle(&self) -> u64 {
        match self {
            Self::Mock(mock) => mock.cycle(),
            Self::Chip(chip) => chip.cycle(),
        }
    }

    /// Whether a host can talk to it.
    #[must_use]
    pub fn configured(&self) -> bool {
        match self {
            Self::Mock(mock) => mock.configured(),
            Self::Chip(chip) => chip.configured(),
        }
    }

    /// Resets since power-up.
    #[must_use]
    pub fn resets(&self) -> u64 {
        match self {
            Self::Mock(mock) => mock.resets(),
            Self::Chip(chip) => chip.resets(),
        }
    }

    /// Sends bytes to one of its functions.
    ///
    /// # Errors
    /// If the emulator is gone or refuses; also for the methods below.
    pub fn write(&mut self, function: Function, bytes: &[u8]) -> Result<(), BenchError> {
        match self {
            Self::Mock(mock) => mock.write(function, bytes),
            Self::Chip(chip) => chip.write(function, bytes)?,
        }
        Ok(())
    }

    /// Runs up to a cycle and returns what it sent.
    ///
    /// # Errors
    /// As for [`Self::write`].
    pub fn run(&mut self, to: u64) -> Result<Heard, BenchError> {
        match self {
            Self::Mock(mock) => {
                mock.run(to);
                Ok(mock.take_heard())
            }
            Self::Chip(chip) => {
                chip.run(to)?;
                Ok(chip.take_heard())
            }
        }
    }

    /// Asks for an e-stop past the bytes that wait. The mock has no control requests; it takes the frame.
    ///
    /// # Errors
    /// As for [`Self::write`].
    pub fn e_stop(&mut self, epoch: u16) -> Result<(), BenchError> {
        match self {
            Self::Mock(_) => Ok(()),
            Self::Chip(chip) => chip.control(e_stop_request(epoch)),
        }
    }

    /// Opens or closes the tty.
    ///
    /// # Errors
    /// As for [`Self::write`].
    pub fn dtr(&mut self, open: bool) -> Result<(), BenchError> {
        match self {
            Self::Mock(mock) => mock.dtr(open),
            Self::Chip(chip) => chip.dtr(open)?,
        }
        Ok(())
    }

    /// Plugs the cable in or out.
    ///
    /// # Errors
    /// As for [`Self::write`].
    pub fn usb(&mut self, plugged: bool) -> Result<(), BenchError> {
        match self {
            Self::Mock(mock) => mock.usb(plugged),
            Self::Chip(chip) => chip.usb(plugged)?,
        }
        Ok(())
    }

    /// Makes the core fail.
    ///
    /// # Errors
    /// As for [`Self::write`].
    pub fn cpu(&mut self, event: CpuEvent) -> Result<(), BenchError> {
        match self {
            Self::Mock(mock) => mock.fail(),
            Self::Chip(chip) => chip.cpu(event),
        }
    }

    /// Takes the recording of the lines since power-up or the last call.
    pub fn take_lines(&mut self) -> Played {
        match self {
            Self::Mock(mock) => Played::Ticks(Box::new(std::mem::take(&mut mock.log))),
            Self::Chip(chip) => Played::Pins(Box::new(std::mem::take(&mut chip.pins))),
        }
    }
}

/// The recording of the lines of one boot.
#[derive(Clone, Debug)]
pub enum Played {
    /// On the mock.
    Ticks(Box<crate::log::Log>),
    /// On the chip.
    Pins(Box<Pins>),
}

impl Played {
    /// The cycle at which the last pulse has fallen.
    #[must_use]
    pub fn low_since(&self, grid: crate::time::Grid) -> Option<u64> {
        match self {
            Self::Ticks(log) => log.end().map(|tick| grid.cycle(tick)),
            Self::Pins(pins) => pins.low_since(u64::MAX),
        }
    }
}
