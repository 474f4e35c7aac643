//! The status: the device, the running play, the queue, the motors.

use serde::{Deserialize, Serialize};

/// The state when no device answers and no emergency stop is latched.
pub const NO_DEVICE: &str = "no-device";

/// Which device is connected.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceInfo {
    /// How it is reached: `mock`, `pty:PATH`, `serial:PATH`.
    pub kind: String,
    /// Firmware version.
    pub firmware: String,
    /// Hash of the firmware's build.
    pub build: String,
    /// Random at every boot; a tick belongs to a boot.
    pub boot: u32,
    /// Whether the shafts are simulated.
    pub simulated: bool,
    /// Whether it measures where its pins are; without that, bursts are not corrected.
    #[serde(default = "usually")]
    pub telemetry: bool,
}

/// A daemon that does not say has devices that do.
const fn usually() -> bool {
    true
}

/// The running play.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunningPlay {
    /// Its id.
    pub id: u64,
    /// Its pattern.
    pub pattern: String,
    /// How long it has played, s.
    pub played_s: f64,
}

/// `202` to `POST /v1/play`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlayAccepted {
    /// The play's id.
    pub id: u64,
}

/// A play that waits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct QueuedPlay {
    /// Its id.
    pub id: u64,
    /// Its pattern.
    pub pattern: String,
}

/// Which real-time means the system granted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Realtime {
    /// The streamer's thread runs under SCHED_FIFO.
    pub fifo: bool,
    /// The process's memory is locked.
    pub mlock: bool,
}

/// Where the estimate of a rest error comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorSource {
    /// Nothing is known.
    #[default]
    None,
    /// Measured by telemetry.
    Telemetry,
    /// Dead reckoning from the bursts played.
    DeadReckoning,
}

/// A motor's part of the status.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorStatus {
    /// Estimated rest error.
    pub rest_error_um: f32,
    /// Where the estimate comes from.
    pub source: ErrorSource,
    /// Whether its gains were measured by a calibration that is used.
    #[serde(default)]
    pub calibrated: bool,
}

/// `GET /v1/status`, and the answer to every command but `play`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// `disarmed`, `armed`, `returning`, `faulted`, or `no-device`.
    pub state: String,
    /// Why.
    pub cause: String,
    /// `known` or `unknown`.
    pub position: String,
    /// The connected device.
    pub device: Option<DeviceInfo>,
    /// The device asked for, as `--device` names it.
    #[serde(default, rename = "wanted")]
    pub requested_device: String,
    /// Why no device is connected, and what to do, as it was found last; null if one is, or was not looked for yet.
    #[serde(default, rename = "missing")]
    pub no_device_reason: Option<String>,
    /// The running play.
    pub play: Option<RunningPlay>,
    /// Plays that wait behind it.
    pub queued: Vec<QueuedPlay>,
    /// The device's clock, now; null without a device.
    pub tick: Option<u64>,
    /// How well it is known.
    pub clock_uncertainty_us: Option<f64>,
    /// The lead asked for; while something is played, the lead that is reached.
    pub lead_ms: f64,
    /// The lease.
    pub lease_ms: f64,
    /// What the line to the device was measured to carry, bytes per second; null until it is.
    #[serde(default)]
    pub line_bytes_per_s: Option<u32>,
    /// The motors, by number.
    pub motors: Vec<MotorStatus>,
    /// When the calibration that is used was made, UTC; null if there is none.
    #[serde(default)]
    pub calibrated: Option<String>,
    /// Which real-time means the system granted the daemon; null from an older one.
    #[serde(default)]
    pub realtime: Option<Realtime>,
    /// Why the logbook is not written at present; null if it is, or none is kept.
    #[serde(default)]
    pub logbook_problem: Option<String>,
    /// Where the daemon listens; empty from an older one.
    #[serde(default)]
    pub socket: String,
    /// The daemon's version.
    pub version: String,
    /// The daemon's process.
    pub pid: u32,
}

impl Status {
    /// Whether a device has said who it is and how it stands: before, it takes no orders.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.device.is_some() && self.state != NO_DEVICE && self.tick.is_some()
    }
}
