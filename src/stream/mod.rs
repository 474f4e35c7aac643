//! placeholder
pub mod port;

use firmware_protocol::limits::OnTimeLimits;
use port::{Notices, Orders};
use std::io;
use std::thread::JoinHandle;

/// What the streamer is told once, at its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How far ahead of now the controller is kept fed, ms.
    pub lead_ms: f64,
    /// Silence after which the controller returns pins and disarms, ms; at least the lead + 50.
    pub lease_ms: f64,
    /// A site's on-time limits.
    pub limits: OnTimeLimits,
}

/// Which real-time means the system granted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Realtime {
    /// The thread runs under SCHED_FIFO.
    pub fifo: bool,
    /// The process's memory is locked.
    pub mlock: bool,
}

/// Starts the streamer's thread.
///
/// # Errors
/// If the system gives no descriptors or no thread.
pub fn spawn(_settings: Settings) -> io::Result<(Orders, Notices, Realtime, JoinHandle<()>)> {
    let (_port, orders, notices) = port::port()?;
    Ok((orders, notices, Realtime::default(), std::thread::spawn(|| {})))
}

/// What a run in virtual time came to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VirtualRun {
    /// Where the pins rested.
    pub rest: crate::plant::RestStats,
    /// The bursts.
    pub bursts: port::Bursts,
    /// Bytes sent to the device.
    pub wire_bytes: u64,
}

/// Placeholder.
#[must_use]
pub fn virtual_run(
    _pattern: &crate::pattern::Pattern,
    _seconds: f64,
    _plant: &crate::plant::PlantConfig,
    _settings: &Settings,
    _open_loop: bool,
) -> VirtualRun {
    VirtualRun::default()
}
