//! Plays a pattern on a device: from a compiled play to bytes on the link, and from the device's reports back to a receipt.
//!
//! # The data path
//! 1. A client puts a [`queues::Request`] into the [`queues::CommandQueue`]; a play has its compiled strokes and the
//!    [`Bandwidth`] it requires (`bandwidth`).
//!    `source` ([`Source`]) is where a play's strokes come from: a pattern, a sequence, or the drives of a live play.
//! 2. `thread` ([`spawn`]) runs the streamer in real time: it takes requests, moves bytes and sleeps until something is due.
//! 3. `streamer` ([`Streamer`]) decides: it executes commands, chooses onsets and sends strokes ahead of time. `active` holds
//!    the state and the account of one play; `board` holds what the device's board reports say of it.
//! 4. `control` corrects bursts from telemetry shortly before they begin: position control, estimator, telemetry monitor.
//! 5. [`link`] turns strokes, corrections and operations into frames, and keeps the clock of the device ([`time`]).
//! 6. [`device`] carries the bytes: USB, a serial port, or the mock with simulated motors.
//! 7. Back the same way: acknowledgements, verdicts, counters and telemetry reach the streamer, which reports
//!    [`queues::StreamEvent`]s through the [`queues::EventQueue`].
//!
//! Beside the path: `checks` tests a play against the controller's limits ([`dry_run`]);
//! [`simulate_play`] and [`Simulation`] (`simulation`) run the same streamer against the mock in virtual
//! time, over a line that may be bad ([`faulty`]); [`forecast_drift`] (`drift`) tells how far a play lets pins drift; [`calibrate`] measures gains; [`diagnostics`] tests a link; [`sync`] is what threads share.
//!
//! # Example
//! ```
//! use meissner_array::{pattern::Pattern, simulated::SimulatedMotorsConfig};
//! use meissner_stream::{Settings, simulate_play};
//!
//! let text = r#"
//! format = 1
//! name = "one-pin"
//! duration_s = 0.5
//! [[drive]]
//! motor = 9
//! frequency_hz = 60.0
//! amplitude_um = 80.0
//! phase = 0.0
//! "#;
//! let pattern = Pattern::parse(text, "one-pin.toml")?;
//! let settings = Settings::of(pattern.array());
//! let played = simulate_play(&pattern, None, &SimulatedMotorsConfig::default(), settings, false)?;
//! assert_eq!(played.outcome.bursts.played, 60); // 30 periods, up and down
//! assert!(played.rest.rms_um() < 20.0); // closed loop, 10 % scatter
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Invariants
//! The streamer is sans-IO: it gets the time, requests and bytes, and never sleeps, reads a clock or touches a port. In
//! real time its loop does not allocate, lock, log or wait for anybody.

mod active;
mod bandwidth;
mod board;
pub mod calibrate;
mod checks;
mod control;
pub mod device;
pub mod diagnostics;
mod drift;
pub mod faulty;
pub mod link;
pub mod queues;
mod settings;
mod simulation;
mod source;
mod streamer;
pub mod sync;
mod thread;
pub mod time;

pub use bandwidth::{Bandwidth, Requirement};
pub use board::PlayBoard;
pub use checks::{Dense, DryRun, Hold, Overpush, STILL_MS, dry_run};
pub use control::Gains;
pub use drift::{Drift, forecast_drift};
pub use faulty::Line;
pub use settings::{LowerStopSettings, Settings};
pub use simulation::{SimulatedPlay, Simulation, SimulationError, simulate_play};
pub use source::Source;
pub use streamer::{Streamer, end_cause, longest_homing_s};
pub use thread::{Turns, request_realtime, spawn};
