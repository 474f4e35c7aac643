//! Receipts: what was asked of a play, what came of it, and when.
//!
//! They are plain data, the same in the daemon that fills them and in the client that reads them. A figure that
//! is not known yet is null, not zero.
//!
//! Invariant: once a receipt has ended, `planned = played + late + dropped + refused` as the streamer counted.

use serde::{Deserialize, Serialize};

/// Strokes listed one by one in a receipt, at the most: late ones and refused ones each.
pub const MAX_LISTED: usize = 100;

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

/// What came of a play: how its bursts (halves of strokes) ended.
/// At the end `planned = played + late + dropped + refused`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BurstCounts {
    /// Handed to the link, or late before they could be.
    pub planned: u64,
    /// Played, whole or cut.
    pub played: u64,
    /// Too late to be played.
    pub late: u64,
    /// Flushed by a stop, a fault or a lost link.
    pub dropped: u64,
    /// Against a limit.
    pub refused: u64,
    /// Played with a corrected count.
    pub amended: u64,
}

/// PulseCounts of a play.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PulseCounts {
    /// Of the planned bursts.
    pub planned: u64,
    /// As the device counted them.
    pub played: u64,
}

/// Where a late stroke lost its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LateCause {
    /// The streamer woke up too late.
    Host,
    /// Sent in time, but it took the link too long.
    Link,
    /// The device gave no credits in time.
    Device,
}

/// The late strokes of a play.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LateCounts {
    /// Strokes by cause.
    pub host: u64,
    /// Strokes by cause.
    pub link: u64,
    /// Strokes by cause.
    pub device: u64,
    /// The latest, ms.
    pub worst_ms: f64,
}

/// The late strokes of a play: how many by cause, the worst, and the first [`MAX_LISTED`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LatenessRecord {
    /// The counts.
    #[serde(flatten)]
    pub counts: LateCounts,
    /// The first of them.
    pub strokes: Vec<LateStroke>,
}

/// The afferent response predicted for a play, from its bursts as they were measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictedResponse {
    /// How much of the play this covers, from its onset on, s.
    pub seconds: f64,
    /// The target the pattern was made for; null: it was made for none.
    pub target: Option<String>,
    /// The seed of the population of afferents and of their noise.
    pub population_seed: u64,
    /// Rates predicted for the pattern as designed, impulses/s.
    pub designed_hz: Rates,
    /// Rates predicted for the bursts as measured, impulses/s.
    pub played_hz: Rates,
    /// BurstCounts without a measurement: they count as not played.
    pub unmeasured: u64,
}

/// What is known of a play's predicted response: nothing yet, the response, or why there is none.
///
/// JSON has each key twice: `predicted_response` and `predicted_response_unknown`, and their deprecated names `felt` and
/// `felt_unknown`. Either name is read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "PredictionKeys", into = "PredictionKeys")]
pub struct Prediction {
    /// The response, once it is computed.
    pub response: Option<PredictedResponse>,
    /// Why it cannot be predicted.
    pub unknown: Option<String>,
}

impl Prediction {
    /// Whether the daemon has computed it, or has given up.
    #[must_use]
    pub const fn is_settled(&self) -> bool {
        self.response.is_some() || self.unknown.is_some()
    }
}

/// The keys of a [`Prediction`].
#[derive(Serialize, Deserialize)]
struct PredictionKeys {
    /// The predicted response; null until it is known.
    #[serde(default)]
    predicted_response: Option<PredictedResponse>,
    /// Why it cannot be predicted; null until the daemon has tried, and if it could.
    #[serde(default)]
    predicted_response_unknown: Option<String>,
    /// Deprecated: read `predicted_response`.
    #[serde(default)]
    felt: Option<PredictedResponse>,
    /// Deprecated: read `predicted_response_unknown`.
    #[serde(default)]
    felt_unknown: Option<String>,
}

impl From<PredictionKeys> for Prediction {
    fn from(keys: PredictionKeys) -> Self {
        Self {
            response: keys.predicted_response.or(keys.felt),
            unknown: keys.predicted_response_unknown.or(keys.felt_unknown),
        }
    }
}

impl From<Prediction> for PredictionKeys {
    fn from(Prediction { response, unknown }: Prediction) -> Self {
        Self {
            predicted_response: response.clone(),
            predicted_response_unknown: unknown.clone(),
            felt: response,
            felt_unknown: unknown,
        }
    }
}

/// Mean rates, impulses/s. Null: the pattern has no target, or no frame of its motion was observed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rates {
    /// Of all afferents.
    pub all: f64,
    /// Of the afferents within reach of the target.
    pub on: Option<f64>,
    /// Of the others.
    pub off: Option<f64>,
    /// On-target minus off-target.
    pub contrast: Option<f64>,
}

/// What went over the wire to the device while a play ran, all overhead included.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinkTraffic {
    /// Bytes of all frames.
    pub bytes_to_device: u64,
    /// Per planned burst; null without bursts.
    pub bytes_per_burst: Option<f64>,
}

impl LinkTraffic {
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
    pub bursts: Option<BurstCounts>,
    /// Its pulses; null until it is over.
    pub pulses: Option<PulseCounts>,
    /// Its late strokes, so far.
    pub lateness: LatenessRecord,
    /// Its refused strokes, so far: the first [`MAX_LISTED`].
    pub refusals: Vec<RefusedStroke>,
    /// What went over the wire; null until it is over.
    pub wire: Option<LinkTraffic>,
    /// Estimated rest error of each motor at the end; null until it is over.
    pub rest_error_um: Option<Vec<f32>>,
    /// The predicted response to its first minute, from its measured bursts; not known until some time after the play's end.
    #[serde(flatten)]
    pub prediction: Prediction,
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
            prediction: Prediction::default(),
        }
    }

    /// Whether it ended by itself with every burst played.
    #[must_use]
    pub fn all_played(&self) -> bool {
        self.state == PlayState::Done && self.bursts.is_some_and(|bursts| bursts.played == bursts.planned)
    }
}
