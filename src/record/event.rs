//! Events: what the daemon tells whoever listens, as it happens.
//!
//! One enum, which the daemon writes and the client reads. An event says what changed, not all that is known: a
//! listener that missed some reads status and receipts.
//!
//! Invariant: [`Event::name`] is the `event` key of its JSON.

use super::felt::FeltRecord;
use super::receipt::{LateStroke, OnsetRecord, Receipt, RefusedStroke};
use crate::stream::Doubt;
use firmware_protocol::message::{DeviceHello, State};
use serde::{Deserialize, Serialize};

/// The state when no device answers and no emergency stop is latched.
pub const NO_DEVICE: &str = "no-device";

/// The controller's state as the API calls it.
#[must_use]
pub const fn state_name(state: State) -> &'static str {
    match state {
        State::Disarmed => "disarmed",
        State::Armed => "armed",
        State::Returning => "returning",
        State::Faulted => "faulted",
    }
}

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

impl DeviceInfo {
    /// What a device said of itself, reached by `kind`.
    #[must_use]
    pub fn new(kind: &str, hello: &DeviceHello) -> Self {
        let [major, minor, patch] = hello.firmware;
        Self {
            kind: kind.to_owned(),
            firmware: format!("{major}.{minor}.{patch}"),
            build: format!("{:08x}", u32::from_be_bytes(hello.build)),
            boot: hello.boot,
            simulated: hello.features & DeviceHello::SIMULATED != 0,
            telemetry: hello.features & DeviceHello::TELEMETRY != 0,
        }
    }
}

/// The running play.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Running {
    /// Its id.
    pub id: u64,
    /// Its pattern.
    pub pattern: String,
    /// How long it has played, s.
    pub played_s: f64,
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
        play: Option<Running>,
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
    /// What was felt of a play, some time after it has ended, or after its first minute; or why that is not known.
    Felt {
        /// The play's id.
        id: u64,
        /// As in its receipt.
        felt: Option<FeltRecord>,
        /// As in its receipt.
        felt_unknown: Option<String>,
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
    Doubted {
        /// Its motor.
        motor: u8,
        /// Why.
        doubt: Doubt,
    },
    /// Without telemetry pins may have drifted further than the site wants to be warned of: `home` offers itself.
    Drifted {
        /// The largest error of all motors, one standard deviation, µm.
        um: f32,
    },
    /// Notices from the streamer were lost: events are missing here, the receipts' counts are right.
    Lost {
        /// How many.
        notices: u64,
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
            Self::Doubted { .. } => "doubted",
            Self::Drifted { .. } => "drifted",
            Self::Ended { .. } => "ended",
            Self::Felt { .. } => "felt",
            Self::Calibrated { .. } => "calibrated",
            Self::Lost { .. } => "lost",
            Self::Lagged { .. } => "lagged",
        }
    }
}
