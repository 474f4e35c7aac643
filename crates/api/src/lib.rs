//! Types of the daemon's local HTTP API: routes, requests, answers, events, errors, and the OpenAPI document made from them.
//!
//! The daemon writes these types and clients read them, so both sides agree by construction; serde gives each type its JSON
//! form. How the bytes travel is not defined here. Modules, in the order of a call:
//!
//! - [`route`]: every route with its method, body and answer. The daemon builds its router from this table. [`access`]: who may
//!   use it.
//! - [`order`]: what to play, when and how, of one item or many; [`item_record`]: what became of each; [`trigger`]: the trigger output;
//!   [`plan_check`]: how far a play would let pins drift.
//! - [`request`]: the other bodies a client sends; [`Order::parse`] and similar functions name the wrong key. How bodies are read, and the
//!   checks that several share, is in `body`.
//! - [`session`]: sessions, whose plays are recorded together and during which one client may own the display.
//! - [`status`], [`receipt`], [`pattern`], [`calibration`]: what the daemon answers; [`board`]: the device's
//!   counters in status and receipt.
//! - [`end_cause`]: why a play ended before its end.
//! - [`live`], [`live_record`]: live plays with the messages of their connections, and their part of a receipt.
//! - [`doctor`]: the problems that the daemon finds on its machine, with advice.
//! - [`rendering`]: renderings of objects, and previews of patterns.
//! - [`token`]: access tokens of network clients.
//! - [`event`]: what the daemon reports as it happens.
//! - [`problem`]: errors, as `application/problem+json`.
//! - [`openapi`]: the OpenAPI document of all of the above, served at `GET /v1/openapi.json`.
//!
//! The streamer shares a few of these types, such as [`LatePolicy`] and [`BurstCounts`], so that each exists once.
//!
//! ```
//! use meissner_api::Order;
//!
//! let order = Order::parse(br#"{"pattern": "edge-45", "seconds": 2}"#)?;
//! assert_eq!(order.items[0].seconds, Some(2.0));
//!
//! let problem = Order::parse(br#"{"pattern": "edge-45", "secnods": 2}"#).unwrap_err();
//! assert_eq!(problem.status, 400);
//! assert_eq!(problem.detail, "unknown key `secnods`: did you mean `seconds`?");
//! # Ok::<(), meissner_api::Problem>(())
//! ```

// The examples of the longest schemas.
#![recursion_limit = "256"]

pub mod access;
pub mod answer;
pub mod array;
pub mod board;
mod body;
pub mod calibration;
pub mod doctor;
pub mod end_cause;
pub mod event;
pub mod item_record;
pub mod live;
pub mod live_record;
pub mod openapi;
pub mod order;
pub mod pattern;
pub mod pattern_choice;
pub mod plan_check;
pub mod problem;
pub mod receipt;
pub mod rendering;
pub mod request;
pub mod route;
pub mod session;
pub mod status;
pub mod token;
pub mod trigger;

pub use answer::{AnswerTaken, PlayAnswer};
pub use array::{ArrayDetails, ArrayDuty, ArrayGrid, ArrayMotor};
pub use board::{BoardRecord, BoardStatus};
pub use body::{Labels, MAX_AT_MS, is_sha256};
pub use calibration::{CalibratedMotor, CalibrationReport, FittedLine, MeasuredPoint, Provenance};
pub use doctor::{DoctorReport, Finding, Level};
pub use end_cause::EndCause;
pub use event::{EdgeEffect, Event, MAX_ITEMS_LISTED};
pub use item_record::{InstantRecord, ItemRecord, ItemState};
pub use live::{
    LIVE_GLIDE_MS, LIVE_TIMEOUT_MS, LIVE_UPDATES_HZ, LiveAccepted, LiveAnswer, LiveApplied, LiveDrive,
    LiveMessage, LivePose, LiveRequest, MAX_LIVE_MESSAGE,
};
pub use live_record::{LiveRecord, UpdateTimes};
pub use order::{Fit, Item, LatePolicy, MAX_ITEMS, MAX_WAIT_S, Order, Terms};
pub use pattern::{
    FollowedMotion, ImportedPattern, PatternDetails, PatternList, PatternSummary, RailLoad, ReachedDrive,
    RemovedPattern,
};
pub use pattern_choice::{MAX_BODY, MAX_PACKED_BODY, PatternChoice};
pub use plan_check::{PlanCheck, PlanStop};
pub use problem::{Code, MAX_DETAIL, Problem, REFERENCE};
pub use receipt::{
    BurstCounts, DurationRecord, EdgeRecord, ErrorSource, LateCause, LateCounts, LateStroke, LatenessRecord,
    LinkTraffic, LoweredPin, LoweredReason, LoweredRecord, MAX_DRIVES_LISTED, MAX_LISTED,
    MAX_WARNINGS_LISTED, MotorRestError, MovedPin, OnsetRecord, OrderedCounts, PlayCounts, PlayDevice,
    PlayEdges, PlayOrder, PlayPins, PlayReach, PlayState, PulseCounts, Receipt, RefusedStroke,
};
pub use rendering::{
    FOUND_PREFIX, JudgedPattern, KEPT_RENDERINGS, MAX_PREVIEW_FROM_S, MAX_PREVIEW_S, MAX_RENDERING_BODY,
    ObjectResponse, PatternPreview, PreviewSpikes, RenderMethod, Rendered, Rendering, RenderingRequest,
    RenderingState,
};
pub use request::{ArmRequest, CalibrateRequest, DisarmRequest, EdgeRequest, ResetRequest, parse_empty};
pub use route::{Method, Route};
pub use session::{
    Losses, RecordNeed, RecordedPlay, Session, SessionList, SessionPlays, SessionRequest, SessionStarted,
};
pub use status::{
    ArmedStatus, ClockSample, DaemonStatus, DeviceInfo, EStopStatus, LinkStatus, MotorStatus, NO_DEVICE,
    Newest, ParticipantStatus, PinHeights, PinMovement, PlayAccepted, QueuedPlay, Realtime, RunningPlay,
    SensorFault, StandingPins, Status,
};
pub use token::{
    CLIENT_HEADER, MAX_TOKENS, NetworkStatus, PREFIX as TOKEN_PREFIX, Role, SESSION_HEADER, TokenCreated,
    TokenInfo, TokenList, TokenRequest,
};
pub use trigger::{TriggerRecord, TriggerRequest, TriggerShape};

/// Clients connected at the same time, at most.
pub const MAX_CLIENTS: usize = 64;
