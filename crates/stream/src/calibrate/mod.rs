//! Calibration: what a pulse really moves each pin by, up and down.
//!
//! A [`Plan`] is a pattern like any other, played open loop: each motor takes bursts of different numbers of pulses, as
//! the paper did for its Fig. 2. How far the pin then went is a [`BurstTravel`], read at rest before and after; who plays the
//! plan on a device reads its telemetry ([`travels_by_telemetry`]), [`travels_by_sensor`] reads the simulated pin itself. A straight line through the
//! blocks of a motor and direction is a [`Fit`] ([`fit`] makes all of them), and its slope over the model's is the gain. A
//! [`Calibration`] keeps the fits in a file, with what they were made by. Nothing here corrects a stroke, opens a
//! device or reads a clock.
//!
//! Invariant: a fit, made or read from a file, has a gain within [`GAIN_RANGE`].

mod error;
mod file;
mod fit;
mod laser;
mod measured;
mod plan;

pub use error::{CalibrationError, Problem};
pub use file::{Calibration, FORMAT, MAX_BYTES};
pub use fit::{Fit, FitError, FitProblem, GAIN_RANGE, MAX_SLOPE_SE, MIN_BURSTS, MotorFit, fit};
pub use laser::travels_by_sensor;
pub use measured::travels_by_telemetry;
pub use plan::{
    DEFAULT_PULSES, DEFAULT_REPETITIONS, GROUP_S, MAX_GROUPS, PULSES_RANGE, Plan, PlanError, PlannedBurst,
    STROKES_PER_GROUP,
};

use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// A burst and how far the pin went: a circle of the paper's Fig. 2, or a square.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BurstTravel {
    /// 0..24.
    pub motor: u8,
    /// Which way the burst goes.
    pub direction: Direction,
    /// Its first pulse.
    pub start: Tick,
    /// Its pulses.
    pub pulses: u16,
    /// How far the pin went the burst's way, µm: above 0 for a down burst that went down.
    pub travel_um: f64,
    /// Whether it is of a group's first stroke, which settles the motor and counts in no fit.
    pub warm_up: bool,
}

/// `upwards` or `downwards`.
const fn way(direction: Direction) -> &'static str {
    match direction {
        Direction::Up => "upwards",
        Direction::Down => "downwards",
    }
}
