//! Ends plays and the thread.
//!
//! Invariant: the account of a play closes with device counters that include all of this play and nothing of the next.

use crate::active::{Active, Ending, Phase};
use crate::link::{Contradiction, Session};
use crate::queues::{CommandError, Emit, Stamp, StreamEvent};
use crate::streamer::Streamer;
use firmware_protocol::message::{Counters, State};
use firmware_protocol::tick::Tick;
use meissner_api::EndCause;

/// The device reports a play's onset and all strokes within this time after its end, s, or withholds reports.
const REPORTED_WITHIN_S: u64 = 5;

impl Streamer {
    /// Cuts all plays, for this reason unless they have one already.
    pub(super) fn cut_all(&mut self, cause: EndCause) {
        for active in self.plays.iter_mut().filter(|active| !active.is_cut()) {
            active.cut(cause.clone());
        }
    }

    /// Ends a play of which nothing was sent, if it is there.
    pub(super) fn withdraw(&mut self, id: u64, emit: &mut dyn Emit) -> Result<(), CommandError> {
        let found = self.plays.iter().position(|active| active.play().id == id && !active.is_cut());
        let Some(index) = found else { return Ok(()) };
        let waits = |active: &Active| active.phase() == Phase::Waiting && active.play().live.is_none();
        if !waits(&self.plays[index]) {
            return Err(CommandError::Begun);
        }
        let Some(mut active) = self.plays.remove(index) else { return Ok(()) };
        active.cut_unsent(EndCause::Withdrawn);
        let after = self.known.status.map(|(status, _)| status.counters);
        let rest = self.control.rest_error_um(self.known.status.map_or(Tick(0), |(_, at)| at));
        let (id, outcome) =
            active.close(Ending { after, wire: 0, offset: None, cut: None, rest, estimated: false });
        emit.event(StreamEvent::PlayEnded { id, outcome });
        Ok(())
    }

    /// Ends all plays with the counters known. Without a report of a cut, they count as cut when the link was `lost`.
    pub(super) fn close_all(
        &mut self,
        after: Option<Counters>,
        link: Option<(&Session, Tick)>,
        emit: &mut dyn Emit,
    ) {
        let lost = link.map(|(_, lost)| lost);
        let wire = link.map_or(0, |(session, _)| session.traffic().bytes_out);
        let rest = self.control.rest_error_um(lost.unwrap_or_default());
        while let Some(active) = self.plays.pop_front() {
            let next = self.plays.iter().find_map(Active::counters_at_onset);
            let (after, estimated) = (next.or(after), next.is_none() && lost.is_some());
            let over = active.cut_at().and_then(|(_, over)| over);
            let clock = link.and_then(|(session, _)| session.clock().estimate());
            let offset = over.zip(clock).map(|(tick, clock)| Stamp::new(tick, &clock));
            let lost = lost.filter(|&lost| active.until() > lost);
            let cut = active.cut_at().map(|(at, _)| at).or(lost);
            let (id, outcome) = active.close(Ending { after, wire, offset, cut, rest, estimated });
            emit.event(StreamEvent::PlayEnded { id, outcome });
        }
    }

    /// Ends the plays that are over, in order.
    pub(super) fn finish(&mut self, tick: Tick, emit: &mut dyn Emit) {
        let (returning, rate) = (self.state() == State::Returning, self.rate());
        let Some(session) = &mut self.session else { return };
        // Asks as soon as the play is over, so that the answer comes with the last status.
        let is_over = |first: &&mut Active| !first.is_cut() && first.end().is_some_and(|end| tick >= end);
        if let Some(first) = self.plays.front_mut().filter(is_over) {
            first.board().ends(tick, rate, || session.ask_board());
        }
        while let Some(first) = self.plays.front() {
            // A play without strokes never starts: the counters at the next onset separate its neighbours.
            let later = || self.plays.iter().skip(1);
            let next_counters = later().find_map(Active::counters_at_onset);
            let Some((status, at)) = self.known.status else { return };
            let after = if first.is_cut() {
                let settled = !self.operations.is_in_flight()
                    && self.operations.is_empty()
                    && session.is_answered()
                    && status.state != State::Returning;
                (settled || first.phase() == Phase::Waiting).then_some(status.counters)
            } else {
                let end = first.end().map_or(first.last_end(), |end| end.max(first.last_end()));
                // Counters that include all of this play and nothing of the next.
                let next_onset = later().find_map(Active::onset).unwrap_or(Tick(u64::MAX));
                let now_known = (at >= end && at < next_onset && first.counters_at_onset().is_some())
                    .then_some(status.counters);
                next_counters
                    .or(now_known)
                    .filter(|_| first.is_decided() && tick >= end && session.known_to() >= end)
            };
            let Some(after) = after else {
                let end = first.end().filter(|&end| tick >= end + REPORTED_WITHIN_S * rate.per_s());
                if !first.is_cut() && end.is_some() {
                    let events = &mut self.events;
                    session.distrust(Contradiction::Reports, &mut |event| events.push_back(event));
                }
                break;
            };
            let Some(first) = self.plays.front_mut() else { break };
            if first.phase() != Phase::Waiting && !first.board().ends(tick, rate, || session.ask_board()) {
                break;
            }
            let wire = session.traffic().bytes_out;
            // The estimates are those of the play's end: no burst of the next play counts yet.
            let end = if first.is_cut() { None } else { first.end() };
            self.control.reckon_to(end.map_or(tick, |end| end.max(first.last_end())));
            let Some(active) = self.plays.pop_front() else { break };
            let over = match (active.cut_at(), active.started()) {
                (Some((_, over)), _) => over,
                (None, Some(onset)) => self.control.over_at(onset.actual, active.until(), None),
                (None, None) => None,
            };
            // Not yet: the device has lost the report of a cut.
            let over = over.filter(|&over| over <= tick);
            let cut = active.cut_at().map(|(at, _)| at);
            let rest = self.control.rest_error_um(tick);
            let offset = over.zip(session.clock().estimate()).map(|(over, clock)| Stamp::new(over, &clock));
            let after = Some(next_counters.unwrap_or(after));
            let estimated = false;
            let (id, outcome) = active.close(Ending { after, wire, offset, cut, rest, estimated });
            emit.event(StreamEvent::PlayEnded { id, outcome });
        }
        let over = self.plays.front().is_some_and(|first| {
            first.is_cut() || (first.phase() == Phase::Streamed && first.end().is_some_and(|end| tick >= end))
        });
        if over || returning || self.operations.is_closing() {
            session.request_status();
        }
    }

    /// Whether the device is off and nothing is under way, or there is none.
    pub(super) fn is_off(&self) -> bool {
        match (&self.session, self.known.status) {
            (Some(session), Some((status, _))) => {
                let quiet = matches!(status.state, State::Disarmed | State::Faulted);
                quiet && session.is_answered() && self.operations.is_empty() && self.plays.is_empty()
            }
            _ => true,
        }
    }
}
