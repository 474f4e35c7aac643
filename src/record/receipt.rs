//! Receipts: what was asked of a play, what came of it, and when.
//!
//! They are plain data, the same in the daemon that fills them and in the client that reads them. A figure that
//! is not known yet is null, not zero.
//!
//! Invariant: once a receipt has ended, `planned = played + late + dropped + refused` as the streamer counted.

use super::felt::FeltRecord;
use crate::stream::port::{Bursts, End, LateCause, Lateness, Onset, Outcome, Pulses};
use firmware_protocol::tick::Tick;
use serde::{Deserialize, Serialize};

/// Strokes listed one by one in a receipt, at the most: late ones and refused ones each.
pub const LISTED: usize = 100;

/// Where a play stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PlayState {
    /// Waits for the plays before it.
    Queued,
    /// Is being played.
    Running,
    /// All of it was streamed and is over.
    Done,
    /// Ended by a stop, replace, disarm, e-stop or lost link.
    Stopped,
    /// Ended by late strokes, or its onset could not be kept.
    Aborted,
}

impl PlayState {
    /// As it stands in the JSON.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::Aborted => "aborted",
        }
    }

    /// Whether nothing more comes of it.
    #[must_use]
    pub const fn is_over(self) -> bool {
        !matches!(self, Self::Queued | Self::Running)
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

/// When a play began, on both clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OnsetRecord {
    /// The tick first asked for.
    pub requested_tick: u64,
    /// The tick at which it began.
    pub actual_tick: u64,
    /// The same on `CLOCK_MONOTONIC`.
    pub monotonic_ns: u64,
    /// How well that is known.
    pub uncertainty_ns: u64,
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

/// A stroke that came late.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LateStroke {
    /// Its motor.
    pub motor: u8,
    /// Its up tick.
    pub tick: u64,
    /// How late.
    pub late_ms: f64,
    /// Why.
    pub cause: LateCause,
}

/// A stroke that was refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusedStroke {
    /// Its motor.
    pub motor: u8,
    /// Its up tick.
    pub tick: u64,
    /// Why.
    pub reason: String,
}

/// The late strokes of a play: how many by cause, the worst, and the first [`LISTED`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LatenessRecord {
    /// The counts.
    #[serde(flatten)]
    pub counts: Lateness,
    /// The first of them.
    pub strokes: Vec<LateStroke>,
}

impl LatenessRecord {
    pub(super) fn add(&mut self, stroke: LateStroke) {
        let counts = &mut self.counts;
        match stroke.cause {
            LateCause::Host => counts.host += 1,
            LateCause::Link => counts.link += 1,
            LateCause::Device => counts.device += 1,
        }
        counts.worst_ms = counts.worst_ms.max(stroke.late_ms);
        if self.strokes.len() < LISTED {
            self.strokes.push(stroke);
        }
    }
}

/// What went over the wire to the device while a play ran, all overhead included.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wire {
    /// Bytes of all frames.
    pub bytes_to_device: u64,
    /// Per planned burst; null without bursts.
    pub bytes_per_burst: Option<f64>,
}

impl Wire {
    /// So many bytes for so many bursts.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "a quotient to read")]
    pub fn new(bytes_to_device: u64, bursts: u64) -> Self {
        let bytes_per_burst = (bursts > 0).then(|| bytes_to_device as f64 / bursts as f64);
        Self { bytes_to_device, bytes_per_burst }
    }
}

/// A play, from its order to its end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Receipt {
    /// Its number since the daemon's start, from 1.
    pub id: u64,
    /// The pattern's name.
    pub pattern: String,
    /// SHA-256 of the pattern's file.
    pub pattern_sha256: String,
    /// How long it was to play; null: as long as the pattern lasts.
    pub seconds: Option<f64>,
    /// Where it stands.
    pub state: PlayState,
    /// Why it ended, unless it is done.
    pub cause: Option<String>,
    /// When it began.
    pub onset: Option<OnsetRecord>,
    /// From the order to the onset.
    pub onset_latency_ms: Option<f64>,
    /// How its bursts ended; null until it is over.
    pub bursts: Option<Bursts>,
    /// Its pulses; null until it is over.
    pub pulses: Option<Pulses>,
    /// Its late strokes, so far.
    pub lateness: LatenessRecord,
    /// Its refused strokes, so far: the first [`LISTED`].
    pub refusals: Vec<RefusedStroke>,
    /// What went over the wire; null until it is over.
    pub wire: Option<Wire>,
    /// Estimated rest error of each motor at the end; null until it is over.
    pub rest_error_um: Option<Vec<f32>>,
    /// What was felt of its first minute at the most, by its bursts as they were measured; null until it is known, some time after
    /// the play's end.
    #[serde(default)]
    pub felt: Option<FeltRecord>,
    /// Why that cannot be known; null until it was tried, and if it is.
    #[serde(default)]
    pub felt_unknown: Option<String>,
}

impl Receipt {
    /// A play that was just ordered.
    #[must_use]
    pub fn new(id: u64, pattern: &str, pattern_sha256: &str, seconds: Option<f64>) -> Self {
        Self {
            id,
            pattern: pattern.to_owned(),
            pattern_sha256: pattern_sha256.to_owned(),
            seconds,
            state: PlayState::Queued,
            cause: None,
            onset: None,
            onset_latency_ms: None,
            bursts: None,
            pulses: None,
            lateness: LatenessRecord::default(),
            refusals: Vec::new(),
            wire: None,
            rest_error_um: None,
            felt: None,
            felt_unknown: None,
        }
    }

    /// Whether it ended by itself with every burst played.
    #[must_use]
    pub fn all_played(&self) -> bool {
        self.state == PlayState::Done && self.bursts.is_some_and(|bursts| bursts.played == bursts.planned)
    }

    pub(super) fn began(&mut self, onset: Onset) {
        self.state = PlayState::Running;
        self.onset = Some(onset.into());
        #[expect(clippy::cast_precision_loss, reason = "milliseconds to read")]
        let latency_ms = onset.latency_ns as f64 / 1e6;
        self.onset_latency_ms = Some(latency_ms);
    }

    pub(super) fn ended(&mut self, outcome: &Outcome) {
        if let Some(onset) = outcome.onset {
            self.began(onset);
        }
        self.state = outcome.end.into();
        self.cause = outcome.cause.map(str::to_owned);
        self.bursts = Some(outcome.bursts);
        self.pulses = Some(outcome.pulses);
        // The streamer's counts hold; notices of single strokes may have been lost.
        self.lateness.counts = outcome.lateness;
        self.wire = Some(Wire::new(outcome.wire_bytes, outcome.bursts.planned));
        self.rest_error_um = Some(outcome.rest_error_um.to_vec());
    }

    pub(super) fn refused(&mut self, motor: u8, up: Tick, reason: &str) {
        if self.refusals.len() < LISTED {
            self.refusals.push(RefusedStroke { motor, tick: up.0, reason: reason.to_owned() });
        }
    }
}
