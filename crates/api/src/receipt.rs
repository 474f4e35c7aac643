//! Receipts: what a play was asked to do, what happened to its bursts, and when.
//!
//! The daemon fills a [`Receipt`] as the play goes on; clients read the same type. A figure that is not known yet is null,
//! not zero. A stroke is one cycle of a motor: a burst of pulses upwards and one downwards.
//!
//! Invariant: in the receipt of an ended play, `planned = played + late + dropped + refused + replaced`, as the streamer counted.

use crate::board::BoardRecord;
use crate::end_cause::EndCause;
use crate::item_record::{InstantRecord, ItemRecord};
use crate::live_record::LiveRecord;
use crate::order::Terms;
use crate::pattern::{FollowedMotion, ReachedDrive};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use utoipa::ToSchema;

/// Strokes listed one by one in a receipt, at most: late ones and refused ones each.
pub const MAX_LISTED: usize = 100;

/// Drives listed in a receipt, at most: one of every motor.
pub const MAX_DRIVES_LISTED: usize = 24;
/// Warnings listed in a receipt, at most; one more line counts the others.
pub const MAX_WARNINGS_LISTED: usize = 8;

/// Where a play stands: `queued`, `running`, or ended as `done` (it came to its end), `stopped` (by a stop, replace, disarm,
/// e-stop, lost link or participant's limit) or `aborted` (by late strokes, or because its onset could not be kept). In the session record
/// also `unknown`: its end is missing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum PlayState {
    /// The play waits for those before it.
    #[default]
    Queued,
    /// The play runs.
    Running,
    /// The play has come to its end.
    Done,
    /// A stop, replace, disarm, e-stop, lost link or participant's limit ended the play.
    Stopped,
    /// Late strokes ended the play, or its onset could not be kept.
    Aborted,
    /// The session record lacks its end.
    Unknown,
}

impl PlayState {
    /// The state's name in the JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::Aborted => "aborted",
            Self::Unknown => "unknown",
        }
    }

    /// Whether the play has ended.
    pub const fn is_over(self) -> bool {
        !matches!(self, Self::Queued | Self::Running)
    }
}

/// When a play began, on the device's clock and on the host's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct OnsetRecord {
    /// The tick that was first asked for, ticks.
    pub requested_tick: u64,
    /// The tick at which the play began, ticks.
    pub actual_tick: u64,
    /// The same instant on the host's `CLOCK_MONOTONIC`, ns.
    pub monotonic_ns: u64,
    /// Uncertainty of `monotonic_ns`, ns.
    pub uncertainty_ns: u64,
    /// Time from the request to the onset, ms.
    pub latency_ms: f64,
}

/// A rising edge of the trigger input, on the device's clock and on the host's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct EdgeRecord {
    /// Its number since the device started, from 1. Numbers that are missing are of edges that the daemon did not hear of.
    pub number: u32,
    /// The tick in which it came, ticks.
    pub tick: u64,
    /// The same instant on the host's `CLOCK_MONOTONIC`, ns.
    pub monotonic_ns: u64,
    /// Uncertainty of `monotonic_ns`, ns.
    pub uncertainty_ns: u64,
}

/// What pattern and order say for the whole play, without corrections.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct OrderedCounts {
    /// Number of bursts; a stroke has two.
    pub bursts: u64,
    /// Number of their pulses.
    pub pulses: u64,
}

/// Durations of a play, ms. A drive plays whole strokes, so a play lasts a little shorter or longer than ordered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DurationRecord {
    /// As ordered, by the request or else by the pattern, ms; null: without end.
    pub ordered: Option<f64>,
    /// As compiled, to the end of the last whole stroke, ms; null: without end.
    pub compiled: Option<f64>,
    /// As played, from the onset to the offset, ms; null until the play is over, or without an offset.
    pub played: Option<f64>,
    /// From the onset to the cut that ended the play, ms; null if it came to its end or never began. If the link was lost: until
    /// the daemon noticed.
    pub cut_after: Option<f64>,
}

/// Where the estimate of a rest error comes from: `telemetry` measured it, `dead-reckoning` computed it from the bursts that were
/// played, `lower-stop`: the pin comes down to a stop after each stroke, `none`: there is no estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorSource {
    /// There is no estimate.
    #[default]
    None,
    /// Telemetry measured it.
    Telemetry,
    /// Dead reckoning: computed from the bursts that were played.
    DeadReckoning,
    /// The pin comes down to a lower stop after each stroke.
    LowerStop,
}

impl ErrorSource {
    /// The source's name in the JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Telemetry => "telemetry",
            Self::DeadReckoning => "dead-reckoning",
            Self::LowerStop => "lower-stop",
        }
    }
}

/// The estimated rest errors of a driven motor. By dead reckoning: one standard deviation, at most the distance of the end stops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct MotorRestError {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// At the play's onset, µm; null if it never began.
    pub onset_um: Option<f32>,
    /// Where `onset_um` comes from; null if the play never began.
    pub onset_source: Option<ErrorSource>,
    /// At the play's offset, µm.
    pub offset_um: f32,
    /// Where `offset_um` comes from.
    pub offset_source: ErrorSource,
}

/// When a pin moved, as far as the device accepted its moves. A play's onset is not yet motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct MovedPin {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// Its first pulse, ticks.
    pub first_pulse_tick: u64,
    /// The first tick after its last pulse, as planned, or when the play was cut, ticks. The return of a pin after a cut comes later.
    pub offset_tick: u64,
}

/// A stroke that came too late.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LateStroke {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// Start of the stroke's upward burst, ticks.
    pub tick: u64,
    /// How late the stroke came, ms.
    pub late_ms: f64,
    /// Where the time was lost.
    pub cause: LateCause,
}

/// Why the device brought a pin down by itself: a move down came `late`, or the pin was `held` for too long.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum LoweredReason {
    /// A move down came too late.
    Late,
    /// The pin stayed above rest without a pulse for longer than the play said.
    Held,
}

/// A pin that the device brought down by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LoweredPin {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// The first tick in which it may have done so.
    pub tick: u64,
    /// Why.
    pub reason: LoweredReason,
}

/// How often the device brought a pin of a play down by itself, and the first 24 times.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LoweredRecord {
    /// How often.
    pub count: u64,
    /// The first 24 times.
    #[schema(max_items = 24)]
    pub pins: Vec<LoweredPin>,
}

impl LoweredRecord {
    /// Most times that are listed.
    pub const MAX_PINS: usize = 24;

    /// Adds a pin to the count, and to the list while there is room.
    pub fn add(&mut self, pin: LoweredPin) {
        self.count += 1;
        if self.pins.len() < Self::MAX_PINS {
            self.pins.push(pin);
        }
    }
}

/// A stroke that the device refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RefusedStroke {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// Start of the stroke's upward burst, ticks.
    pub tick: u64,
    /// Why the device refused it.
    pub reason: String,
}

/// What happened to the bursts of a play; a stroke has two. At the end `planned = played + late + dropped + refused
/// + replaced`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BurstCounts {
    /// Number of bursts handed to the link, or late before they could be.
    pub planned: u64,
    /// Number of bursts played, whole or cut.
    pub played: u64,
    /// Number of bursts that came too late.
    pub late: u64,
    /// Number of bursts flushed by a stop, a fault or a lost link.
    pub dropped: u64,
    /// Number of bursts the device refused, because of a limit.
    pub refused: u64,
    /// Number of bursts of which an update of a live play took the place before they began.
    pub replaced: u64,
    /// Number of bursts played with a pulse count that feedback corrected.
    pub amended: u64,
    /// Number of bursts played, but cut short by the motor's next move: the pin went on from where it was.
    pub shortened: u64,
}

/// The pulses of a play.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct PulseCounts {
    /// Number of pulses in the planned bursts.
    pub planned: u64,
    /// Number of pulses the device counted.
    pub played: u64,
}

/// Where a late stroke lost its time: in the `host` (the streamer woke up too late), on the `link`, or for want of credits from
/// the `device`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum LateCause {
    /// The streamer woke up too late.
    Host,
    /// The streamer sent it in time, but the link took too long.
    Link,
    /// The device gave no credits in time.
    Device,
}

/// The late strokes of a play, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LateCounts {
    /// Number of strokes late because the streamer woke up too late.
    pub host: u64,
    /// Number of strokes late on the link.
    pub link: u64,
    /// Number of strokes late because the device gave no credits.
    pub device: u64,
    /// The largest delay, ms; 0 without late strokes.
    pub worst_ms: f64,
}

/// The late strokes of a play: counts by cause, the largest delay, and the first 100 strokes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LatenessRecord {
    /// The counts.
    #[serde(flatten)]
    pub counts: LateCounts,
    /// The first 100 of them.
    #[schema(max_items = 100)]
    pub strokes: Vec<LateStroke>,
}

/// What the daemon sent to the device while a play ran, all overhead included.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LinkTraffic {
    /// Size of all frames, bytes.
    pub bytes_to_device: u64,
    /// Size of all frames per planned burst, bytes; null without bursts.
    pub bytes_per_burst: Option<f64>,
}

impl LinkTraffic {
    /// The traffic of `bytes_to_device` bytes for `bursts` planned bursts.
    pub fn new(bytes_to_device: u64, bursts: u64) -> Self {
        let bytes_per_burst = (bursts > 0).then(|| bytes_to_device as f64 / bursts as f64);
        Self { bytes_to_device, bytes_per_burst }
    }
}

/// What a play was asked to do: its terms, and how many items it has. [`ItemRecord`]s say what was asked of each.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlayOrder {
    /// How many items it has.
    #[schema(minimum = 1, maximum = 4096)]
    pub items: u64,
    /// When, and how: the terms of the order, without those that were left out.
    #[serde(flatten)]
    #[schema(ignore)]
    pub terms: Terms,
}

/// The edges of the trigger input that concern a play.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct PlayEdges {
    /// The edge after which the play begins, of a play with `on_edge_ms`; null until it has come, or without one.
    pub start: Option<EdgeRecord>,
    /// The edge that stopped the play, of a play with `stop_on_edge`; null if none did.
    pub stop: Option<EdgeRecord>,
}

/// What was ordered, and what became of it, counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlayCounts {
    /// What pattern and order say; null for an endless play, and for one that takes too long to count, such as more than 2 million
    /// strokes and moves.
    pub ordered: Option<OrderedCounts>,
    /// What happened to the bursts; null until the play is over.
    pub bursts: Option<BurstCounts>,
    /// The pulses; null until the play is over.
    pub pulses: Option<PulseCounts>,
    /// Whether what was played is an estimate: the link was lost before the device said what it has counted. It counts what was to be
    /// played until the daemon noticed, or until its e-stop.
    pub estimated: bool,
    /// The late strokes so far.
    pub lateness: LatenessRecord,
    /// The refused strokes so far: the first 100.
    #[schema(max_items = 100)]
    pub refusals: Vec<RefusedStroke>,
    /// The pins that the device has brought down by itself.
    pub lowered: LoweredRecord,
}

/// What the motors can do of what was ordered, computed before the play.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlayReach {
    /// What the drives of a play of one item reach: the first 24.
    #[schema(max_items = 24)]
    pub drives: Vec<ReachedDrive>,
    /// How the motors follow their motions, by motor; empty without motions. Of several items those of the item in which the motor is
    /// off the most, with the first instant, from the play's onset, at which it is too slow.
    #[schema(max_items = 64)]
    pub motions: Vec<FollowedMotion>,
    /// One line for each thing that may not be meant, for example a drive that does not reach its amplitude: the first 8, and how
    /// many more.
    #[schema(max_items = 9)]
    pub warnings: Vec<String>,
}

/// Where the pins of a play were, and when they moved.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlayPins {
    /// Estimated offset of each pin from rest at the end, µm, by motor, as in the status.
    #[schema(max_items = 24)]
    pub rest_error_um: Vec<f32>,
    /// The rest errors of the driven motors at onset and offset.
    #[schema(max_items = 24)]
    pub rest_errors: Vec<MotorRestError>,
    /// When each pin that moved did so, by motor.
    #[schema(max_items = 64)]
    pub moved: Vec<MovedPin>,
}

/// The device that a play was for, and what went on there meanwhile.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlayDevice {
    /// The array that was driven.
    pub array: String,
    /// Rate of its device's ticks, Hz: the receipt's ticks count in them.
    #[schema(minimum = 20000, maximum = 200_000)]
    pub tick_hz: u32,
    /// The boot of the device that took the play: ticks of two plays of one boot are on one clock. Null: the daemon does not know it.
    pub boot: Option<u32>,
    /// What was sent to the device; null until the play is over.
    pub wire: Option<LinkTraffic>,
    /// What occurred on the device meanwhile; null until the play is over, or if its reports do not cover the whole play.
    pub board: Option<BoardRecord>,
}

/// The result of a play.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "id": 7, "name": "edge-45", "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    "order": {
        "items": 1, "late": "drop", "replace": false, "open_loop": false, "session": "20261122T083000Z-9f3c", "trial": 12,
        "labels": {"condition": "a"}
    },
    "state": "done", "cause": null, "edges": {"start": null, "stop": null},
    "onset": {
        "requested_tick": 6442460000_u64, "actual_tick": 6442460000_u64, "monotonic_ns": 75793647058823_u64,
        "uncertainty_ns": 9600, "latency_ms": 106.3
    },
    "offset": {"tick": 6442629900_u64, "monotonic_ns": 75795645882352_u64, "uncertainty_ns": 9600},
    "duration_ms": {"ordered": 2000.0, "compiled": 1998.8, "played": 1998.8, "cut_after": null},
    "items": [{
        "item": 0, "pattern": "edge-45", "pattern_sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
        "scale": 1.0, "ordered_um": 80.0, "reached_um": 69.2, "planned_onset_ticks": 0, "ordered_ms": 1998.8,
        "state": "incomplete",
        "onset": {"tick": 6442460000_u64, "monotonic_ns": 75793647058823_u64, "uncertainty_ns": 9600},
        "first_pulse_tick": 6442460000_u64,
        "offset": {"tick": 6442629900_u64, "monotonic_ns": 75795645882352_u64, "uncertainty_ns": 9600},
        "trigger": {"tick": 6442460000_u64, "width_ms": 10.0, "code": null}, "late_strokes": 1, "refused_strokes": 0
    }],
    "counts": {
        "ordered": {"bursts": 1240, "pulses": 86800},
        "bursts": {"planned": 1240, "played": 1238, "late": 2, "dropped": 0, "refused": 0, "replaced": 0, "amended": 1221, "shortened": 0},
        "pulses": {"planned": 86800, "played": 86660},
        "estimated": false,
        "lateness": {
            "host": 1, "link": 0, "device": 0, "worst_ms": 1.8,
            "strokes": [{"motor": 3, "tick": 6442470000_u64, "late_ms": 1.8, "cause": "host"}]
        },
        "refusals": [],
        "lowered": {"count": 0, "pins": []}
    },
    "reach": {
        "drives": [{"drive": 1, "motor": 9, "ordered_um": 80.0, "reached_um": 69.2, "surplus_um": 0.0, "strokes": 119}],
        "motions": [], "warnings": []
    },
    "live": null,
    "pins": {
        "rest_error_um": [0.4, -0.2],
        "rest_errors": [{
            "motor": 9, "onset_um": 0.1, "onset_source": "telemetry", "offset_um": 0.4, "offset_source": "telemetry"
        }],
        "moved": [{"motor": 9, "first_pulse_tick": 6442460000_u64, "offset_tick": 6442629900_u64}]
    },
    "device": {
        "array": "tula35-6x4", "tick_hz": 85000, "boot": 305419896,
        "wire": {"bytes_to_device": 14260, "bytes_per_burst": 11.5},
        "board": {"slack_ticks": 29, "stalls": 0, "usb_recoveries": 0, "output_faults": 0}
    }
})))]
pub struct Receipt {
    /// The play's id: its number since the daemon's start.
    #[schema(minimum = 1)]
    pub id: u64,
    /// What the play is called: as its order is, or else its one pattern, or `sequence`; `live` for a live play.
    pub name: String,
    /// SHA-256 of the pattern's file, in hexadecimal; of several items, or of one in an order with a name, that of the items as JSON; of a
    /// live play that of its request.
    pub sha256: String,
    /// What it was asked to do.
    pub order: PlayOrder,
    /// Where the play stands.
    pub state: PlayState,
    /// Why the play ended; null if it is not over or came to its end.
    #[schema(value_type = Option<String>)]
    pub cause: Option<EndCause>,
    /// The edges of the trigger input that started and stopped it.
    pub edges: PlayEdges,
    /// When the play began; null before.
    pub onset: Option<OnsetRecord>,
    /// When the last pulse was over, with the return of a play that was cut; null until the play is over, if nothing was played,
    /// or if the link was lost before the device reported it. Corrections count as sent: if the line lost the last one, the tick is off by
    /// its pulses.
    pub offset: Option<InstantRecord>,
    /// How long the play was to last, and lasted.
    pub duration_ms: DurationRecord,
    /// What became of the items; null until the play is over. The event `ended` has them only of a play of one item: events `items` come
    /// before it.
    #[schema(value_type = Option<Vec<ItemRecord>>, max_items = 4096)]
    pub items: Option<Arc<[ItemRecord]>>,
    /// What was ordered and played.
    pub counts: PlayCounts,
    /// What the motors can do of it.
    pub reach: PlayReach,
    /// What became of the updates of a live play, once it is over; null for another play.
    pub live: Option<LiveRecord>,
    /// Where the pins were, and when they moved; null until the play is over.
    pub pins: Option<PlayPins>,
    /// The device, and what went on there.
    pub device: PlayDevice,
}

impl Receipt {
    /// The receipt of a play that was just requested. Its array is the paper's until another is set.
    pub fn new(name: &str, sha256: &str, items: usize, terms: &Terms) -> Self {
        let device = PlayDevice { array: "tula35-6x4".to_owned(), tick_hz: 85_000, ..PlayDevice::default() };
        let order = PlayOrder { items: items as u64, terms: terms.clone() };
        Self { name: name.to_owned(), sha256: sha256.to_owned(), order, device, ..Self::default() }
    }

    /// The session that the play belongs to.
    pub fn session(&self) -> Option<&str> {
        self.order.terms.session.as_deref()
    }

    /// Whether the play came to its end with every burst played.
    pub fn all_played(&self) -> bool {
        self.state == PlayState::Done
            && self.counts.bursts.is_some_and(|bursts| bursts.played == bursts.planned)
    }
}
