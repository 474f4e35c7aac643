//! The streamer: keeps the controller fed, corrects strokes from telemetry, and accounts for every burst.
//!
//! [`Streamer`] decides, sans-IO: it is told the time, orders and bytes, and says what to send and what has
//! happened; it never sleeps, reads a clock or touches a port. `thread` runs it in real time around a device,
//! [`simulate_play`] in virtual time around the mock: same code, same answers. In real time its loop does not
//! allocate, lock, log or wait on anybody ([`port`]).

mod active;
mod bandwidth;
pub mod calibrate;
mod control;
pub mod device;
pub mod diagnostics;
pub mod link;
mod motor_run;
pub mod queues;
mod simulation;
mod streamer;
mod thread;
pub mod time;

pub use bandwidth::{Bandwidth, Requirement};
pub use control::{Gains, rest_bound_um};
use firmware_protocol::limits::OnTimeLimits;
use meissner_array::units::ms_in_ticks;
pub use motor_run::{MotorRun, Period};
pub use simulation::{Line, SimulatedPlay, Simulation, SimulationError, simulate_play};
pub use streamer::{ANOTHER_DEVICE, Streamer, cause_text};
pub use thread::{request_realtime, spawn};

/// What the streamer is told once, at its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How far ahead of now the controller is kept fed, ms.
    pub lead_ms: f64,
    /// Silence after which the controller returns pins and disarms, ms; at least the lead + 50.
    pub lease_ms: f64,
    /// A site's on-time limits.
    pub limits: OnTimeLimits,
    /// Dead reckoning's error, one standard deviation, above which a warning is given, µm.
    pub drift_warning_um: f32,
}

impl Default for Settings {
    /// 100 ms ahead: stock kernels stall for 25 ms.
    fn default() -> Self {
        Self { lead_ms: 100.0, lease_ms: 300.0, limits: OnTimeLimits::NONE, drift_warning_um: 100.0 }
    }
}

/// Strokes are handed over so often that a frame carries many of them.
const LONGEST_BATCH_MS: f64 = 12.5;

/// Strokes are handed over in stretches of so many ticks.
fn batch_ticks(settings: &Settings) -> u64 {
    ms_in_ticks((settings.lead_ms / 4.0).min(LONGEST_BATCH_MS)) as u64
}
