//! Events: what the daemon tells whoever listens, as it happens.
//!
//! One enum, which the daemon writes and the client reads. An event says what changed, not all that is known: a
//! listener that missed some reads status and receipts.
//!
//! Invariant: [`Event::name`] is the `event` key of its JSON.

use crate::receipt::{LateStroke, OnsetRecord, Prediction, Receipt, RefusedStroke};
use crate::status::{DeviceInfo, RunningPlay};
use serde::{Deserialize, Serialize};

/// Why the telemetry of a motor is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SensorFault {
    /// It jumps where nothing moved, or moves where it should rest.
    Jumps,
    /// What it shows of bursts is far from what any motor does: too little, too much.
    Gain,
    /// What it shows of equal bursts differs by more than any motor's scatter.
    Scatter,
    /// Corrections have stood at their limit for long, and the shaft has not come nearer to its rest.
    Limit,
}

impl SensorFault {
    /// In words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Jumps => "its telemetry moves where its bursts do not",
            Self::Gain => "its telemetry shows far less or more travel than its bursts make",
            Self::Limit => "corrections at their limit have not brought it nearer to its rest",
            Self::Scatter => "its telemetry has little to do with its bursts",
        }
    }
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// How everything stands: on change, ten times a second while something is played, and first of all.
    State {
        /// As in the status.
        state: String,
        /// Why.
        cause: String,
        /// `known` or `unknown`.
        position: String,
        /// The device's clock.
        tick: u64,
        /// The running play.
        play: Option<RunningPlay>,
    },
    /// A device answered the handshake.
    Connected {
        /// Which.
        device: DeviceInfo,
    },
    /// The device is gone.
    Disconnected {
        /// Why.
        reason: String,
    },
    /// A play was taken.
    Queued {
        /// Its id.
        id: u64,
        /// Its pattern.
        pattern: String,
        /// How long it will play; null: as long as the pattern lasts.
        seconds: Option<f64>,
    },
    /// A play has begun.
    Began {
        /// Its id.
        id: u64,
        /// When.
        onset: OnsetRecord,
    },
    /// A stroke came late and was dropped whole.
    Late {
        /// The play's id.
        id: u64,
        /// Which and why.
        #[serde(flatten)]
        stroke: LateStroke,
    },
    /// A stroke was refused.
    Refused {
        /// The play's id.
        id: u64,
        /// Which and why.
        #[serde(flatten)]
        stroke: RefusedStroke,
    },
    /// A play is over.
    Ended {
        /// What came of it.
        receipt: Box<Receipt>,
    },
    /// The predicted response to a play, or why there is none: some time after its end or its first minute. The event keeps its
    /// old name, `felt`.
    #[serde(rename = "felt")]
    PredictedResponse {
        /// The play's id.
        id: u64,
        /// As in its receipt.
        #[serde(flatten)]
        prediction: Prediction,
    },
    /// A calibration was stored and is used from now on, or was not.
    Calibrated {
        /// The play that measured it.
        id: u64,
        /// The motors it measured.
        motors: Vec<u8>,
        /// Why nothing was stored; null if it was.
        problem: Option<String>,
    },
    /// The telemetry of a motor is not believed: it plays in open loop until the next `arm`.
    #[serde(rename = "doubted")]
    SensorFault {
        /// Its motor.
        motor: u8,
        /// Why.
        #[serde(rename = "doubt")]
        fault: SensorFault,
    },
    /// Without telemetry pins may have drifted further than the site wants to be warned of: `home` offers itself.
    Drifted {
        /// The largest error of all motors, one standard deviation, µm.
        um: f32,
    },
    /// Notices from the streamer were lost: events are missing here, the receipts' counts are right.
    Lost {
        /// How many.
        #[serde(rename = "notices")]
        events: u64,
    },
    /// This listener was too slow.
    Lagged {
        /// Events it did not get.
        events: u64,
    },
}

impl Event {
    /// The name under which it is sent.
    #[must_use]
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
            Self::Drifted { .. } => "drifted",
            Self::Ended { .. } => "ended",
            Self::PredictedResponse { .. } => "felt",
            Self::Calibrated { .. } => "calibrated",
            Self::Lost { .. } => "lost",
            Self::Lagged { .. } => "lagged",
        }
    }
}
