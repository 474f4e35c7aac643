//! Ends plays and the thread.
//!
//! Invariant: the account of a play closes with device counters that include all of this play and nothing of the next.

use crate::active::Phase;
use crate::link::Contradiction;
use crate::queues::{CommandError, Emit, End, StreamEvent};
use crate::streamer::{ANSWER_WITHIN, Streamer, answer};
use crate::time::HostInstant;
use firmware_protocol::message::{Counters, State};
use firmware_protocol::stroke::MOTORS;
use firmware_protocol::tick::Tick;
use meissner_array::units::TICKS_PER_S;

/// The device reports a play's onset and all strokes within this time after its end, ticks, or withholds reports.
const REPORTED_WITHIN: u64 = 5 * TICKS_PER_S;

impl Streamer {
    /// Cuts all plays, for this reason unless they have one already.
    pub(super) fn cut_all(&mut self, end: End, cause: &'static str) {
        for active in &mut self.plays {
            active.cut = active.cut.or(Some((end, cause)));
        }
    }

    /// Ends all plays with the counters known.
    pub(super) fn close_all(
        &mut self,
        after: Option<Counters>,
        wire: u64,
        rest_um: [f32; MOTORS],
        emit: &mut dyn Emit,
    ) {
        while let Some(active) = self.plays.pop_front() {
            let until = self.plays.iter().find_map(|next| next.counters_at_onset).or(after);
            let (id, outcome) = active.close(until, wire, rest_um);
            emit.event(StreamEvent::PlayEnded { id, outcome });
        }
    }

    /// Ends the plays that are over, in order.
    pub(super) fn finish(&mut self, tick: Tick, emit: &mut dyn Emit) {
        let returning = self.state() == State::Returning;
        let Some(session) = &mut self.session else { return };
        while let Some(first) = self.plays.front() {
            // A play without strokes never starts: the counters at the next onset separate its neighbours.
            let later = || self.plays.iter().skip(1);
            let next_counters = later().find_map(|next| next.counters_at_onset);
            let Some((status, at)) = &self.status else { return };
            let after = if first.cut.is_some() {
                let settled = !self.in_flight
                    && self.pending_ops.is_empty()
                    && session.is_answered()
                    && status.state != State::Returning;
                (settled || first.phase == Phase::Waiting).then_some(status.counters)
            } else {
                let end = first.end().map_or(first.last_end, |end| end.max(first.last_end));
                let decided = first.phase == Phase::Streamed && first.undecided == 0;
                // Counters that include all of this play and nothing of the next.
                let next_onset = later().find_map(|next| next.onset).unwrap_or(Tick(u64::MAX));
                let now_known = (*at >= end && *at < next_onset && first.counters_at_onset.is_some())
                    .then_some(status.counters);
                next_counters.or(now_known).filter(|_| decided && tick >= end && session.known_to() >= end)
            };
            let Some(after) = after else {
                let end = first.end().filter(|&end| tick >= end + REPORTED_WITHIN);
                if first.cut.is_none() && end.is_some() {
                    let events = &mut self.events;
                    session.distrust(Contradiction::Reports, &mut |event| events.push_back(event));
                }
                break;
            };
            let wire = session.traffic().bytes_out;
            // The estimates are those of the play's end: of bursts of the next play nothing counts yet.
            let end = if first.cut.is_some() { None } else { first.end() };
            self.control.reckon_to(end.map_or(tick, |end| end.max(first.last_end)));
            let rest_um = self.control.rest_error_um(tick).map(|(um, _)| um);
            let Some(active) = self.plays.pop_front() else { break };
            let (id, outcome) = active.close(Some(next_counters.unwrap_or(after)), wire, rest_um);
            emit.event(StreamEvent::PlayEnded { id, outcome });
        }
        let over = self.plays.front().is_some_and(|first| {
            first.cut.is_some()
                || (first.phase == Phase::Streamed && first.end().is_some_and(|end| tick >= end))
        });
        if over || returning || self.closing.is_some() {
            session.request_status();
        }
    }

    /// Ends the thread once the device is off, or after a timeout.
    pub(super) fn close(&mut self, now: HostInstant, emit: &mut dyn Emit) {
        let Some((ticket, since)) = self.closing else { return };
        let off = match (&self.session, &self.status) {
            (Some(session), Some((status, _))) => {
                let quiet = matches!(status.state, State::Disarmed | State::Faulted);
                quiet && session.is_answered() && self.pending_ops.is_empty() && self.plays.is_empty()
            }
            _ => true,
        };
        if off || now.since(since) >= ANSWER_WITHIN {
            self.closing = None;
            self.closed = true;
            answer(ticket, if off { Ok(()) } else { Err(CommandError::Timeout) }, emit);
        }
    }
}
