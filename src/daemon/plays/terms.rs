//! The terms that every play has, whatever it plays: when, what to do with late strokes, instead of what, for which session.
//!
//! The onset and the trigger of a request become those of the streamer here.

use firmware_protocol::message::Trigger;
use firmware_protocol::tick::Tick;
use meissner_api::{
    EdgeRequest, Labels, LatePolicy, LiveRequest, PlayRequest, Receipt, SequenceRequest, TriggerRequest,
    TriggerShape,
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
    pub(super) stop_on_edge: bool,
    pub(super) session: Option<String>,
    trial: Option<u64>,
    labels: Labels,
}

/// The terms of a request at an onset; all requests call them the same.
macro_rules! terms {
    ($request:expr, $at:expr, $stop_on_edge:expr) => {{
        let request = $request;
        Self {
            at: $at,
            late: request.late,
            replace: request.replace,
            open_loop: request.open_loop,
            stop_on_edge: $stop_on_edge,
            session: request.session.clone(),
            trial: request.trial,
            labels: request.labels.clone(),
        }
    }};
}

/// The onset that a request asks for; at most one of these keys is set.
macro_rules! onset {
    ($request:expr) => {{
        let request = $request;
        match (request.at_tick, request.at_ms, request.at_monotonic_ns, request.on_edge_ms) {
            (Some(tick), ..) => At::Tick(Tick(tick)),
            (_, Some(ms), ..) => At::After(nanoseconds(ms)),
            (_, _, Some(ns), _) => At::Monotonic(HostInstant::from_ns(ns)),
            (.., Some(ms)) => At::Edge(nanoseconds(ms)),
            (None, None, None, None) => At::Next,
        }
    }};
}

impl From<&PlayRequest> for Terms {
    fn from(request: &PlayRequest) -> Self {
        terms!(request, onset!(request), request.stop_on_edge)
    }
}

impl From<&SequenceRequest> for Terms {
    fn from(request: &SequenceRequest) -> Self {
        terms!(request, onset!(request), request.stop_on_edge)
    }
}

impl From<&LiveRequest> for Terms {
    fn from(request: &LiveRequest) -> Self {
        terms!(request, At::Next, false)
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

/// When an edge of the simulated array comes.
pub(in crate::daemon) fn edge_at(request: &EdgeRequest) -> At {
    match (request.at_tick, request.at_ms) {
        (Some(tick), _) => At::Tick(Tick(tick)),
        (_, Some(ms)) => At::After(nanoseconds(ms)),
        (None, None) => At::Next,
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
    (ms * 1e6).round() as u64
}
