//! Events: what the daemon reports as it happens, to every listener of `GET /v1/events`.
//!
//! The daemon writes this enum and the client reads it. An event says what changed, not all that is known: a listener that
//! missed some reads the status and the receipts.
//!
//! Invariant: [`Event::name`] is the `event` key of its JSON.

use crate::end_cause::EndCause;
use crate::item_record::ItemRecord;
use crate::receipt::{EdgeRecord, LateStroke, OnsetRecord, Receipt, RefusedStroke};
use crate::rendering::RenderingState;
use crate::session::Session;
use crate::status::{DeviceInfo, RunningPlay, SensorFault};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// The state: first of all, at every change, and ten times a second during a play.
    #[schema(examples(json!({
        "event": "state", "state": "armed", "cause": "request", "position": "known", "tick": 6442450944_u64,
        "play": {"id": 7, "name": "edge-45", "played_s": 0.52}
    })))]
    State {
        /// As in the status.
        state: String,
        /// As in the status.
        cause: String,
        /// Whether the device knows where its pins are: `known` or `unknown`.
        position: String,
        /// The device's clock, ticks; 0 without a device.
        tick: u64,
        /// The running play; null without one.
        play: Option<RunningPlay>,
    },
    /// A device has completed the handshake.
    #[schema(examples(json!({
        "event": "connected",
        "device": {
            "kind": "mock", "firmware": "0.1.0", "build": "6d656973", "boot": 305419896, "simulated": true, "telemetry": true, "trigger_input": true
        }
    })))]
    Connected {
        /// The device.
        device: DeviceInfo,
    },
    /// The device is gone.
    #[schema(examples(json!({"event": "disconnected", "reason": "the device does not answer any more"})))]
    Disconnected {
        /// Why, in one line.
        #[schema(value_type = String)]
        reason: EndCause,
    },
    /// A play was queued.
    #[schema(examples(json!({"event": "queued", "id": 7, "name": "edge-45", "ordered_ms": 2000.0})))]
    Queued {
        /// The play's id.
        id: u64,
        /// What the play is called.
        name: String,
        /// Duration as ordered, ms; null: without end.
        ordered_ms: Option<f64>,
    },
    /// A play has begun.
    #[schema(examples(json!({
        "event": "began", "id": 7,
        "onset": {
            "requested_tick": 6442460000_u64, "actual_tick": 6442460000_u64, "monotonic_ns": 75793647058823_u64,
            "uncertainty_ns": 9600, "latency_ms": 106.3
        }
    })))]
    Began {
        /// The play's id.
        id: u64,
        /// When the play began.
        onset: OnsetRecord,
    },
    /// A stroke came too late; the device dropped it whole.
    #[schema(examples(json!({
        "event": "late", "id": 7, "motor": 3, "tick": 6442470000_u64, "late_ms": 1.8, "cause": "host"
    })))]
    Late {
        /// The play's id.
        id: u64,
        /// The stroke, and why it came late.
        #[serde(flatten)]
        stroke: LateStroke,
    },
    /// The device refused a stroke.
    #[schema(examples(json!({
        "event": "refused", "id": 7, "motor": 3, "tick": 6442470000_u64, "reason": "a motor's on-time limit"
    })))]
    Refused {
        /// The play's id.
        id: u64,
        /// The stroke, and why the device refused it.
        #[serde(flatten)]
        stroke: RefusedStroke,
    },
    /// A rising edge of the trigger input.
    #[schema(examples(json!({
        "event": "edge", "number": 12, "tick": 6442455750_u64, "monotonic_ns": 75793597058823_u64, "uncertainty_ns": 9600,
        "play": 7, "effect": "start"
    })))]
    Edge {
        /// The edge.
        #[serde(flatten)]
        edge: EdgeRecord,
        /// The play that it starts or stops, or that ran when it came; null without one.
        play: Option<u64>,
        /// What it does.
        effect: EdgeEffect,
    },
    /// What became of the items of a play of several: up to 32 of them in one event, those that have begun, right before its event `ended`.
    #[schema(examples(json!({
        "event": "items", "id": 7, "session": null, "items": [{
            "item": 0, "pattern": "edge-45", "pattern_sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
            "scale": 1.0, "ordered_um": 80.0, "reached_um": 69.2, "planned_onset_ticks": 0, "ordered_ms": 500.0,
            "state": "played",
            "onset": {"tick": 6442460000_u64, "monotonic_ns": 75793647058823_u64, "uncertainty_ns": 9600},
            "first_pulse_tick": 6442460000_u64,
            "offset": {"tick": 6442502400_u64, "monotonic_ns": 75794145882352_u64, "uncertainty_ns": 9600},
            "trigger": {"tick": 6442460000_u64, "width_ms": 4.0, "code": 1}, "late_strokes": 0, "refused_strokes": 0
        }]
    })))]
    Items {
        /// The play's id.
        id: u64,
        /// The session that it belongs to; null without one.
        session: Option<String>,
        /// The items.
        #[schema(max_items = 32)]
        items: Vec<ItemRecord>,
    },
    /// A play has ended.
    Ended {
        /// The play's result.
        receipt: Box<Receipt>,
    },
    /// A calibration has ended: the daemon has stored and uses it, or says why not.
    #[schema(examples(json!({"event": "calibrated", "id": 7, "motors": [3], "problem": null})))]
    Calibrated {
        /// The id of the play that measured it.
        id: u64,
        /// The motors that were measured.
        motors: Vec<u8>,
        /// Why nothing was stored; null if it was.
        problem: Option<String>,
    },
    /// The daemon does not trust the telemetry of a motor: the motor plays in open loop until the next `arm`.
    #[serde(rename = "doubted")]
    #[schema(examples(json!({"event": "doubted", "motor": 3, "doubt": "jumps"})))]
    SensorFault {
        /// The motor's number.
        #[schema(minimum = 0, maximum = 63)]
        motor: u8,
        /// Why.
        #[serde(rename = "doubt")]
        fault: SensorFault,
    },
    /// The device contradicted itself, in this way for the first time since it was connected. The daemon ignored the message; it
    /// counts all of them in the metrics, and disconnects a device that goes on.
    #[schema(examples(json!({"event": "contradiction", "kind": "clock"})))]
    Contradiction {
        /// The kind of contradiction, as in the metric `meissner_contradictions_total`.
        kind: String,
    },
    /// Without telemetry, pins may have drifted beyond the configured `drift_warning_um`: home them.
    #[schema(examples(json!({"event": "drifted", "um": 21.5})))]
    Drifted {
        /// Largest expected offset from rest of all motors, root mean square, µm.
        um: f32,
    },
    /// A session has begun.
    #[schema(examples(json!({
        "event": "session-started", "session": {
            "id": "20261122T083000Z-9f3c", "participant": "P07", "experiment": "edges", "labels": {}, "seed": 42,
            "exclusive": true, "owner": "ada", "started": "2026-11-22T09:30:00.123456+01:00", "ended": null, "reason": null,
            "plays": 0, "vibration_s": 0.0, "released": false, "release_in_s": 120.0, "lost": {"entries": 0, "plays": 0}
        }
    })))]
    SessionStarted {
        /// The session.
        session: Box<Session>,
    },
    /// The owner of an exclusive session was silent for too long: others may act. The session goes on.
    #[schema(examples(json!({"event": "session-released", "session": "20261122T083000Z-9f3c"})))]
    SessionReleased {
        /// The session's id.
        session: String,
    },
    /// A client that does not own the exclusive session has stopped the display or disarmed the motors, as everybody may.
    #[schema(examples(json!({
        "event": "intervened", "command": "disarm", "by": "bob (uid 1001, pid 99)", "session": "20261122T083000Z-9f3c"
    })))]
    Intervened {
        /// `stop` or `disarm`.
        command: String,
        /// The client.
        by: String,
        /// The session's id.
        session: String,
    },
    /// The daemon has heard nothing of the clients that use the motors for the stated time: it stops and disarms.
    #[schema(examples(json!({"event": "owner-silent", "by": "ada (uid 1000, pid 4711)", "silence_s": 10.0})))]
    OwnerSilent {
        /// The client that armed last.
        by: String,
        /// The stated time, s.
        #[schema(minimum = 1.0)]
        silence_s: f64,
    },
    /// A session has ended.
    #[schema(examples(json!({
        "event": "session-ended", "session": {
            "id": "20261122T083000Z-9f3c", "participant": "P07", "experiment": "edges", "labels": {}, "seed": 42,
            "exclusive": true, "owner": "ada", "started": "2026-11-22T09:30:00.123456+01:00",
            "ended": "2026-11-22T10:30:00.123456+01:00", "reason": "request", "plays": 12, "vibration_s": 24.0,
            "released": false, "release_in_s": null, "lost": {"entries": 0, "plays": 0}
        }
    })))]
    SessionEnded {
        /// The session.
        session: Box<Session>,
    },
    /// The session record has a problem, has it no more, or has lost entries.
    #[schema(examples(json!({
        "event": "record-problem",
        "problem": "the session record cannot be written: /var/lib/meissner/logbook: No space left on device (os error 28)", "lost": 3
    })))]
    RecordProblem {
        /// Why it cannot be written, or what is missing there; null if all is well.
        problem: Option<String>,
        /// Entries that it lost since the daemon started.
        lost: u64,
    },
    /// How a rendering stands: at its start, when its pattern can be played, and at its end.
    #[schema(examples(json!({
        "event": "rendering", "id": 3, "state": "running", "object": "my-edge", "found": false, "seconds": 0.4, "problem": null
    })))]
    Rendering {
        /// The rendering's id.
        id: u64,
        /// How it stands.
        state: RenderingState,
        /// The name of the object.
        object: String,
        /// Whether the pattern can be played as `rendering:ID`.
        found: bool,
        /// Time since its start, s.
        seconds: f64,
        /// Why it failed, in one line; null if it did not.
        problem: Option<String>,
    },
    /// The daemon was too slow for its streamer: events are missing. The receipts' counts are right.
    #[schema(examples(json!({"event": "lost", "notices": 3})))]
    Lost {
        /// Number of events that are missing.
        #[serde(rename = "notices")]
        events: u64,
    },
    /// This listener was too slow.
    #[schema(examples(json!({"event": "lagged", "events": 12})))]
    Lagged {
        /// Number of events this listener did not get.
        events: u64,
    },
}

/// What an edge of the trigger input does: nothing but to `mark` a moment, or it makes a play `start` after its delay, or `stop`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum EdgeEffect {
    /// It is only recorded.
    Mark,
    /// A play that waited for it begins after its delay.
    Start,
    /// The play that runs is stopped.
    Stop,
}

/// Items of a play in one event, at most.
pub const MAX_ITEMS_LISTED: usize = 32;

impl Event {
    /// The name under which the daemon sends it.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::State { .. } => "state",
            Self::Connected { .. } => "connected",
            Self::Disconnected { .. } => "disconnected",
            Self::Queued { .. } => "queued",
            Self::Began { .. } => "began",
            Self::Late { .. } => "late",
            Self::Refused { .. } => "refused",
            Self::SensorFault { .. } => "doubted",
            Self::Contradiction { .. } => "contradiction",
            Self::Drifted { .. } => "drifted",
            Self::Edge { .. } => "edge",
            Self::Items { .. } => "items",
            Self::Ended { .. } => "ended",
            Self::Calibrated { .. } => "calibrated",
            Self::SessionStarted { .. } => "session-started",
            Self::SessionReleased { .. } => "session-released",
            Self::Intervened { .. } => "intervened",
            Self::OwnerSilent { .. } => "owner-silent",
            Self::SessionEnded { .. } => "session-ended",
            Self::RecordProblem { .. } => "record-problem",
            Self::Rendering { .. } => "rendering",
            Self::Lost { .. } => "lost",
            Self::Lagged { .. } => "lagged",
        }
    }
}
