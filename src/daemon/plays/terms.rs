//! The terms that every play has, whatever it plays: when, what to do with late strokes, instead of what, for which session.
//!
//! The onset and the trigger of a request become those of the streamer here.

use firmware_protocol::message::Trigger;
use firmware_protocol::tick::Tick;
use meissner_api::{
    Labels, LatePolicy, LiveRequest, PlayRequest, Receipt, SequenceRequest, TriggerRequest, TriggerShape,
};
use meissner_array::units::TickRate;
use meissner_stream::queues::At;
use meissner_stream::time::HostInstant;

/// See the module.
#[derive(Debug)]
pub(super) struct Terms {
    pub(super) at: At,
    pub(super) late: LatePolicy,
    pub(super) replace: bool,
    pub(super) open_loop: bool,
    pub(super) session: Option<String>,
    trial: Option<u64>,
    labels: Labels,
}

/// The terms of a request at an onset; all requests call them the same.
macro_rules! terms {
    ($request:expr, $at:expr) => {{
        let request = $request;
        Self {
            at: $at,
            late: request.late,
            replace: request.replace,
            open_loop: request.open_loop,
            session: request.session.clone(),
            trial: request.trial,
            labels: request.labels.clone(),
        }
    }};
}

impl From<&PlayRequest> for Terms {
    fn from(request: &PlayRequest) -> Self {
        terms!(request, onset(request.at_tick, request.at_ms, request.at_monotonic_ns))
    }
}

impl From<&SequenceRequest> for Terms {
    fn from(request: &SequenceRequest) -> Self {
        terms!(request, onset(request.at_tick, request.at_ms, request.at_monotonic_ns))
    }
}

impl From<&LiveRequest> for Terms {
    fn from(request: &LiveRequest) -> Self {
        terms!(request, At::Next)
    }
}

impl Terms {
    /// The receipt of a play of this pattern, which has no id yet.
    pub(super) fn receipt(&self, pattern: &str, sha256: &str, seconds: Option<f64>) -> Receipt {
        let &Self { late: late_policy, open_loop, trial, .. } = self;
        let (session, labels) = (self.session.clone(), self.labels.clone());
        Receipt {
            session,
            trial,
            labels,
            late_policy,
            open_loop,
            ..Receipt::new(0, pattern, sha256, seconds)
        }
    }
}

/// The onset that a request asks for; at most one of these keys is set.
fn onset(tick: Option<u64>, ms: Option<f64>, monotonic_ns: Option<u64>) -> At {
    match (tick, ms, monotonic_ns) {
        (Some(tick), ..) => At::Tick(Tick(tick)),
        (_, Some(ms), _) => At::After(nanoseconds(ms)),
        (.., Some(ns)) => At::Monotonic(HostInstant::from_ns(ns)),
        (None, None, None) => At::Next,
    }
}

/// The trigger output's pulse for a request.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked: half a second at most")]
pub(super) fn trigger(request: Option<TriggerRequest>, rate: TickRate) -> Option<Trigger> {
    let shape = match request {
        Some(TriggerRequest::Off) => return None,
        Some(TriggerRequest::On(shape)) => shape,
        None => TriggerShape::default(),
    };
    let width = rate.ms_in_ticks(shape.width_ms()).round() as u16;
    Some(Trigger { width, code: shape.code.unwrap_or(0) })
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked: 0 to an hour")]
fn nanoseconds(ms: f64) -> u64 {
    (ms * 1e6) as u64
}
