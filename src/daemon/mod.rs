//! The daemon: the streamer's thread, and around it clients, patterns, devices, receipts and the session record.
//!
//! Threads: `streamer` and `estop` (real time; an emergency stop needs no other), `connector` (opens devices),
//! `rendering` and `preview` (follow a process), `session record` (disk), and the runtime's one thread for clients and events. An idle daemon runs no timer except a service manager's watchdog.
//!
//! A folder is a room: all of one subject, with its part of the state (`state`), its rules and its handlers.
//! - `plays`: what every play goes through, from a request to the streamer's answer: orders and receipts.
//! - `live`: plays that a client moves.
//! - `arm`: whether pins may move: arming, silence, emergency stops, homing.
//! - `sessions`: sessions, who acts, and what they may do.
//! - `exposure`: a participant's vibration and its limits.
//! - `calibration`: measures, fits, stores and applies gains.
//! - `patterns`: the pattern that a request names.
//! - `jobs`: renderings and previews, in processes of their own.
//! - `tokens`: access tokens.
//! - `status`: what the daemon tells about itself.
//! - `page`: the page in the browser.
//!
//! Below the rooms:
//! - `net`: sockets, who may pass, HTTP; emergency stops are ordered here.
//! - `core`: the lock over the state, commands to the streamer, its events, the device, the runtime.
//!
//! `run` starts and ends the daemon; `routes` leads each request to its handler. For the fuzzer there is also `fuzzed`: requests without a
//! socket.

mod arm;
mod calibration;
mod core;
mod exposure;
#[cfg(fuzzing)]
mod fuzzed;
mod jobs;
mod live;
mod net;
mod page;
mod patterns;
mod plays;
mod routes;
mod run;
mod sessions;
mod status;
#[cfg(any(test, feature = "bench"))]
mod tests;
mod tokens;

pub use self::core::check::{MEMORY_BOUND, check, check_memory};
pub use self::core::error::DaemonError;
pub use self::core::panics::end_on_panic;
pub use self::core::runtime::runtime;
pub use self::core::signals::Signals;
#[cfg(fuzzing)]
pub use fuzzed::{Fuzzed, estop_token};
pub use net::socket::SocketError;
pub use run::{Daemon, Hosted};
#[cfg(any(test, feature = "bench"))]
pub use tests::seeds::{Report, run_days};
