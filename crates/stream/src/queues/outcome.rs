//! The outcome of a play and the snapshot of the streamer: the data of receipts and of the status.
//!
//! The streamer fills them; the daemon turns them into the API's types.

use crate::board::PlayBoard;
use crate::link::{ClockEstimate, Traffic};
use crate::queues::play::{Edge, Play, Stamp};
use crate::settings::Settings;
use crate::time::HostInstant;
use firmware_protocol::board::Board;
use firmware_protocol::message::{Cause, State};
use firmware_protocol::tick::Tick;
use meissner_api::{
    BurstCounts, EdgeRecord, EndCause, ErrorSource, InstantRecord, LateCounts, OnsetRecord, PlayState,
    PulseCounts, SensorFault,
};
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::units::ns_to_ms;

/// How a play ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum End {
    /// Played to its end.
    Done,
    /// By a stop, replace, disarm, e-stop, lost link.
    Stopped,
    /// By late strokes under `LatePolicy::Abort`, or an onset missed.
    Aborted,
}

impl End {
    pub(crate) fn by(cause: Option<&EndCause>) -> Self {
        match cause {
            None => Self::Done,
            Some(cause) if cause.is_abort() => Self::Aborted,
            Some(_) => Self::Stopped,
        }
    }
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
    /// Its uncertainty, ns.
    pub uncertainty_ns: u64,
    /// From the command to the onset, ns.
    pub latency_ns: u64,
}

impl From<Onset> for OnsetRecord {
    fn from(onset: Onset) -> Self {
        Self {
            requested_tick: onset.requested.0,
            actual_tick: onset.actual.0,
            monotonic_ns: onset.at.as_ns(),
            uncertainty_ns: onset.uncertainty_ns,
            latency_ms: ns_to_ms(onset.latency_ns),
        }
    }
}

impl From<Edge> for EdgeRecord {
    fn from(Edge { number, at }: Edge) -> Self {
        Self { number, tick: at.tick.0, monotonic_ns: at.at.as_ns(), uncertainty_ns: at.uncertainty_ns }
    }
}

impl From<Stamp> for InstantRecord {
    fn from(offset: Stamp) -> Self {
        Self { tick: offset.tick.0, monotonic_ns: offset.at.as_ns(), uncertainty_ns: offset.uncertainty_ns }
    }
}

/// The estimated rest errors of all motors at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestErrors {
    /// Of each motor, µm.
    pub um: PerMotor<f32>,
    /// Where the estimates come from.
    pub source: PerMotor<ErrorSource>,
}

impl RestErrors {
    /// No error is known.
    pub fn none(array: Array) -> Self {
        Self { um: PerMotor::all(array, 0.0), source: PerMotor::all(array, ErrorSource::None) }
    }
}

/// How far and how often a pin moved in a span of time, as planned: without the corrections of position control.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Movement {
    /// The lowest level, pulses above rest.
    pub low: u16,
    /// The highest level, pulses above rest.
    pub high: u16,
    /// Strokes per second, or half as many changes of direction.
    pub hz: f32,
}

/// What is known of the pins at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Pins {
    /// The estimated rest errors.
    pub rest: RestErrors,
    /// Why a motor's telemetry is not trusted.
    pub sensor_faults: PerMotor<Option<SensorFault>>,
    /// What each pin did in the 0.2 s before.
    pub movements: PerMotor<Movement>,
    /// The height in pulses of the highest pin that a cut has left above rest, and since when; `None`: all have come back.
    pub standing: Option<(u16, HostInstant)>,
    /// Telemetry shows all pins, or did until the last cut: a device sends none while it is disarmed.
    pub seen: bool,
}

/// A finished play.
#[derive(Debug)]
pub struct Outcome {
    /// How it ended.
    pub end: End,
    /// Why, unless it is done.
    pub cause: Option<EndCause>,
    /// When it began; `None`: never.
    pub onset: Option<Onset>,
    /// The edge of the trigger input that it waited for.
    pub started_by: Option<Edge>,
    /// The edge that stopped it.
    pub stopped_by: Option<Edge>,
    /// When its last pulse was over; `None`: nothing was played, or the link was lost before the device reported it.
    pub offset: Option<Stamp>,
    /// From the onset to the cut that ended it, ticks; `None` if nothing cut it. If the link was lost: until the host noticed.
    pub cut_after: Option<u64>,
    /// Its bursts.
    pub bursts: BurstCounts,
    /// Its pulses.
    pub pulses: PulseCounts,
    /// The link was lost before the device said what it has counted: what was played is estimated.
    pub estimated: bool,
    /// Its late strokes.
    pub lateness: LateCounts,
    /// What occurred on the device meanwhile; `None` if its reports do not cover the whole play.
    pub board: Option<PlayBoard>,
    /// Bytes sent to the device while it ran, all overhead included.
    pub wire_bytes: u64,
    /// The rest errors at its onset; `None` if it never began.
    pub rest_at_onset: Option<RestErrors>,
    /// The rest errors at its end.
    pub rest_at_end: RestErrors,
    /// The play itself, to be dropped outside the thread.
    pub play: Box<Play>,
}

/// The state of streamer and device, reported on change and ten times a second while playing.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot {
    /// When it was taken.
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
    /// The estimate of that clock; `None` before the first answer.
    pub clock: Option<ClockEstimate>,
    /// The running play's id and how long it has played, s.
    pub play: Option<(u64, f64)>,
    /// The lead reached, ms: less than set if the device's credits do not allow more.
    pub lead_ms: f64,
    /// The settings in use.
    pub settings: Settings,
    /// What is known of the pins.
    pub pins: Pins,
    /// Measured capacity of the line, bytes/s; `None` before the link probe.
    pub line_bytes_per_s: Option<u32>,
    /// Bytes and frames since the device was connected.
    pub traffic: Traffic,
    /// The last board report since it was connected.
    pub board: Option<Board>,
    /// Frames from the host that the device could not read since it was switched on.
    pub device_bad_frames: u64,
}
