//! The words of the local API: requests, answers, events and problems.
//!
//! The daemon writes these types and clients read them; every type has its JSON form by serde. [`request`] holds what a
//! client sends, [`status`], [`receipt`], [`pattern`] and [`calibration`] what the daemon answers, [`event`] what it
//! tells as it happens, [`problem`] what it refuses. How they travel is not said here.
//!
//! The crate also holds the few words that the streamer shares with the API, as [`LatePolicy`] and [`BurstCounts`], so that
//! each exists once.

pub mod calibration;
pub mod event;
pub mod pattern;
pub mod problem;
pub mod receipt;
pub mod request;
pub mod status;

pub use calibration::{CalibratedMotor, CalibrationReport, Provenance};
pub use event::{Event, SensorFault};
pub use pattern::{ImportedPattern, PatternList, PatternSummary};
pub use problem::{Code, Problem};
pub use receipt::{
    BurstCounts, LateCause, LateCounts, LateStroke, LatenessRecord, LinkTraffic, MAX_LISTED, OnsetRecord,
    PlayState, PredictedResponse, Prediction, PulseCounts, Rates, Receipt, RefusedStroke,
};
pub use request::{ArmRequest, CalibrateRequest, LatePolicy, MAX_AT_MS, MAX_BODY, PlayRequest, parse_empty};
pub use status::{
    DeviceInfo, ErrorSource, MotorStatus, NO_DEVICE, PlayAccepted, QueuedPlay, Realtime, RunningPlay, Status,
};

/// Clients connected at the same time, at the most.
pub const MAX_CLIENTS: usize = 64;
