//! What a request says of a play becomes what the streamer and the receipt have: onset, trigger, terms.

use firmware_protocol::message::Trigger;
use firmware_protocol::tick::Tick;
use meissner_api::{EdgeRequest, Terms, TriggerRequest, TriggerShape};
use meissner_array::units::TickRate;
use meissner_stream::queues::At;
use meissner_stream::time::HostInstant;

/// The onset that a play's terms ask for; at most one of these keys is set.
pub(in crate::daemon) fn onset(terms: &Terms) -> At {
    match (terms.at_tick, terms.at_ms, terms.at_monotonic_ns, terms.on_edge_ms) {
        (Some(tick), ..) => At::Tick(Tick(tick)),
        (_, Some(ms), ..) => At::After(nanoseconds(ms)),
        (_, _, Some(ns), _) => At::Monotonic(HostInstant::from_ns(ns)),
        (.., Some(ms)) => At::Edge(nanoseconds(ms)),
        (None, None, None, None) => At::Next,
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
pub(in crate::daemon) fn trigger(request: Option<TriggerRequest>, rate: TickRate) -> Option<Trigger> {
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
