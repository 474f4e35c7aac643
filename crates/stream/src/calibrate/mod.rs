//! Calibration: how far a pulse really moves each pin, up and down.
//!
//! 1. `plan`: a [`Plan`] is a pattern like any other, played open loop. Each motor plays bursts of different numbers of
//!    pulses, as in the paper's Fig. 2.
//! 2. `travel`: a [`BurstTravel`] is how far a burst moved its pin, from telemetry ([`travels_by_telemetry`]) or on the
//!    simulated motors ([`travels_by_sensor`]).
//! 3. `fit`: a [`Fit`] is a straight line through the travels of a motor and direction; its slope over the model's is the
//!    gain. [`fit`](fn@fit) fits all motors.
//! 4. `calibration`: a [`Calibration`] holds the fits and how they were made; `file` reads and writes it as TOML.
//! 5. `laser` is the plan for a device without telemetry, and its document: Python fits a recording of a displacement sensor to it.
//!
//! Nothing here corrects a stroke, opens a device or reads a clock.
//!
//! Invariant: a fit, made here or read from a file, has a gain within [`GAIN_RANGE`].

mod calibration;
mod file;
mod fit;
mod laser;
mod plan;
mod travel;

pub use calibration::{Calibration, CalibrationError, FORMAT, MAX_BYTES, Problem};
pub use fit::{Fit, FitError, FitPoint, FitProblem, GAIN_RANGE, MAX_SLOPE_SE, MIN_BURSTS, MotorFit, fit};
pub use laser::{BurstDirection, LASER_REPETITIONS, PlayedBurst, PlayedOn, PlayedPlan, laser_plan};
pub use plan::{
    DEFAULT_REPETITIONS, GROUP_S, MAX_GROUPS, Plan, PlanError, PlannedBurst, STROKES_PER_GROUP, pulses_range,
};
pub use travel::{BurstTravel, travels_by_sensor, travels_by_telemetry};
