//! What came of a play, and how everything stands: the figures that receipts and the status are made of.

use crate::link::BadFrames;
use crate::queues::Play;
use crate::time::HostInstant;
use firmware_protocol::message::{Cause, State};
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::Tick;
use meissner_api::{BurstCounts, ErrorSource, LateCounts, OnsetRecord, PlayState, PulseCounts};

/// How a play ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum End {
    /// All of it was streamed and is over.
    Done,
    /// By a stop, replace, disarm, e-stop, lost link.
    Stopped,
    /// By late strokes under `LatePolicy::Abort`, or an onset that could not be kept.
    Aborted,
}

impl From<End> for PlayState {
    fn from(end: End) -> Self {
        match end {
            End::Done => Self::Done,
            End::Stopped => Self::Stopped,
            End::Aborted => Self::Aborted,
        }
    }
}

/// When a play began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Onset {
    /// The tick first asked for.
    pub requested: Tick,
    /// The tick at which the device began it.
    pub actual: Tick,
    /// The same on `CLOCK_MONOTONIC`.
    pub at: HostInstant,
    /// How well that is known, ns.
    pub uncertainty_ns: u64,
    /// From the order to the onset, ns.
    pub latency_ns: u64,
}

impl From<Onset> for OnsetRecord {
    fn from(onset: Onset) -> Self {
        Self {
            requested_tick: onset.requested.0,
            actual_tick: onset.actual.0,
            monotonic_ns: onset.at.as_ns(),
            uncertainty_ns: onset.uncertainty_ns,
        }
    }
}

/// A finished play.
#[derive(Debug)]
pub struct Outcome {
    /// How it ended.
    pub end: End,
    /// Why, unless it is done.
    pub cause: Option<&'static str>,
    /// When it began; `None` if it never did.
    pub onset: Option<Onset>,
    /// Its bursts.
    pub bursts: BurstCounts,
    /// Its pulses.
    pub pulses: PulseCounts,
    /// Its late strokes.
    pub lateness: LateCounts,
    /// Bytes of the frames sent to the device while it ran, all overhead included.
    pub wire_bytes: u64,
    /// Estimated rest error of each motor at the end, µm.
    pub rest_error_um: [f32; MOTORS],
    /// The play itself, to be dropped outside the thread.
    pub play: Box<Play>,
}

/// What a burst really came to, as telemetry shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredBurst {
    /// Its motor.
    pub motor: u8,
    /// Its first tick.
    pub start: Tick,
    /// Its direction.
    pub direction: Direction,
    /// Its pulses, as corrected.
    pub pulses: u16,
    /// How far the shaft went, µm; up is positive.
    pub travel_um: f32,
    /// One standard deviation of that, µm.
    pub sd_um: f32,
    /// It came after half a second of rest: the transient of the paper's Fig. 2.
    pub rested: bool,
}

/// How everything stands, published on change and ten times a second while something is played.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot {
    /// When this was true.
    pub at: HostInstant,
    /// Whether a device answers.
    pub connected: bool,
    /// The controller's state; [`State::Faulted`] also when the daemon latched an e-stop without a device.
    pub state: State,
    /// Why.
    pub cause: Cause,
    /// Whether the device knows where the pins are.
    pub position_known: bool,
    /// The device's clock, estimated for `at`.
    pub tick: Tick,
    /// How well it is known, µs.
    pub clock_uncertainty_us: f64,
    /// The running play's id and how long it has played, s.
    pub play: Option<(u64, f64)>,
    /// Lead that is really reached, ms: less than asked for if the device's credits do not allow it.
    pub lead_ms: f64,
    /// The lease that is gone by, ms.
    pub lease_ms: f64,
    /// Estimated rest error per motor, µm.
    pub rest_error_um: [f32; MOTORS],
    /// Where the estimates come from.
    pub source: [ErrorSource; MOTORS],
    /// Bytes per second the line was measured to carry; `None` until it is.
    pub line_bytes_per_s: Option<u32>,
    /// Bytes sent to and received from the device since it was connected.
    pub bytes_out: u64,
    /// Bytes received.
    pub bytes_in: u64,
    /// Frames sent again.
    pub retransmitted: u64,
    /// Frames from the device that the host could not read since it was connected.
    pub bad_frames: BadFrames,
    /// Frames from the host that the device could not read since it was switched on.
    pub device_bad_frames: u64,
}
