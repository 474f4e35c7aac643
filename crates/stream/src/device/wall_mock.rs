//! The mock in wall time: each read lets it run up to now.
//!
//! It has no thread: its time passes only when its owner calls it with the host's instant.

use crate::device::error::DeviceError;
use crate::device::mock::{Mock, TruePositions};
use crate::time::HostInstant;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_array::units::TickRate;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;

/// A mock whose clock follows the host's.
#[derive(Debug)]
pub struct WallMock {
    /// Of its clock.
    rate: TickRate,
    mock: Mock,
    /// When its clock stood at [`Tick::BOOT`].
    started: HostInstant,
}

impl WallMock {
    /// A mock of this array that boots at `now`.
    ///
    /// # Errors
    /// If the settings of the simulated motors are out of range.
    pub fn new(array: Array, motors: &SimulatedMotorsConfig, now: HostInstant) -> Result<Self, DeviceError> {
        let boot = RandomState::new().build_hasher().finish() as u32;
        Ok(Self { rate: array.rate(), mock: Mock::new(array, *motors, boot)?, started: now })
    }

    /// The mock itself.
    pub fn mock(&mut self) -> &mut Mock {
        &mut self.mock
    }

    /// Which simulated array it is: see [`SimulatedMotorsConfig::identity`].
    #[must_use]
    pub fn identity(&self) -> String {
        self.mock.identity()
    }

    /// Where its pins really are.
    #[must_use]
    pub fn true_positions(&self) -> Arc<TruePositions> {
        self.mock.true_positions()
    }

    /// Takes in the bytes that were written, and runs up to `now`.
    pub(super) fn run(&mut self, now: HostInstant) {
        self.mock.run(Tick::BOOT + self.rate.duration_to_ticks(now.since(self.started)));
    }
}
