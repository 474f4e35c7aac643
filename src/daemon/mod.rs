//! The daemon: the streamer's thread, and around it clients, patterns, devices, receipts and the session record.
//!
//! Threads: `streamer` and `acceptor` (real time; an emergency stop needs no other), `connector` (opens devices),
//! `rendering` and `preview` (follow a process), `session record` (disk), and the runtime's one thread for clients and events. An idle daemon runs no timer except a service manager's watchdog.
//!
//! The folders, as a request meets them:
//! - `sockets`: a connection, from the moment it is accepted to its bytes; emergency stops are ordered here.
//! - `network`: which requests may pass, by host, origin, token and role.
//! - `http`: the server, the routes and their handlers, one file for each resource.
//! - `page`: the page in the browser.
//! - `plays`: what every play goes through, from a request to the streamer's answer: orders, live plays, calibrations.
//! - `engine`: commands to the streamer and their answers; emergency stops; the status; the log's lines; rights that outlive a request.
//! - `state`: the daemon's state behind one lock.
//! - `beside`: what runs beside the requests: the streamer's events, devices, fits, renderings, the service manager.
//! - `system`: the system around all of them.
//!
//! `run` starts and ends the daemon. For the fuzzer and the bench (`tests/bench.rs`) there is also `fuzzed`: requests without a socket.
//!
//! Each folder uses only those below it in this order, from the top: `run`, `http`, `plays`, `beside`, `sockets`, `engine`, `state`,
//! `network`, `page`, `system`.

mod beside;
mod engine;
#[cfg(any(fuzzing, test, feature = "bench"))]
mod fuzzed;
mod http;
mod network;
mod page;
mod plays;
mod run;
mod sockets;
mod state;
mod system;
#[cfg(any(test, feature = "bench"))]
mod tests;

#[cfg(fuzzing)]
pub use fuzzed::Fuzzed;
pub use run::{Daemon, Hosted};
pub use system::check::{MEMORY_BOUND, check, check_memory};
pub use system::error::DaemonError;
pub use system::panics::end_on_panic;
pub use system::runtime::runtime;
pub use system::signals::Signals;
pub use system::socket::SocketError;
#[cfg(any(test, feature = "bench"))]
pub use tests::seeds::{Report, run_days};
