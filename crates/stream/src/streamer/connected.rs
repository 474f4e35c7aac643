//! The streamer's parts while a device is connected, at one instant: what sends strokes works on them.
//!
//! Invariant: the account of a play closes with device counters that include all of this play and nothing of the next.

use crate::active::{Active, Ending, Phase};
use crate::control::PositionControl;
use crate::link::{Contradiction, Event, Session};
use crate::queues::{Emit, Stamp};
use crate::settings::Settings;
use crate::streamer::known::Known;
use crate::streamer::operations::Operations;
use crate::streamer::plays::Plays;
use crate::time::HostInstant;
use firmware_protocol::message::{Op, State};
use firmware_protocol::tick::Tick;
use meissner_api::LateCause;
use meissner_array::strokes::Step;
use meissner_array::units::TickRate;
use std::collections::VecDeque;

/// The device reports a play's onset and all strokes within this time after its end, s, or withholds reports.
const REPORTED_WITHIN_S: u64 = 5;

/// See the module.
pub(super) struct Connected<'a> {
    pub(super) now: HostInstant,
    /// The device's tick at `now`.
    pub(super) tick: Tick,
    pub(super) state: State,
    pub(super) settings: &'a Settings,
    pub(super) known: &'a Known,
    pub(super) session: &'a mut Session,
    pub(super) operations: &'a mut Operations,
    pub(super) plays: &'a mut Plays,
    pub(super) control: &'a mut PositionControl,
}

impl Connected<'_> {
    pub(super) fn rate(&self) -> TickRate {
        self.settings.array.rate()
    }

    /// Orders an operation that nobody waits for.
    pub(super) fn order(&mut self, op: Op, emit: &mut dyn Emit) {
        self.operations.order(self.now, 0, op, Some(&mut *self.session), self.control, emit);
    }

    /// A play aborts: returns the pins and disarms.
    pub(super) fn abort(&mut self, emit: &mut dyn Emit) {
        self.operations.abort(self.now, Some(&mut *self.session), self.control, emit);
    }

    /// Counts and reports a late step; `free` was the first tick that could be played.
    pub(super) fn late(&mut self, step: &Step, free: Tick, cause: LateCause, emit: &mut dyn Emit) {
        if self.plays.late(step, free, cause, self.rate(), emit) {
            self.abort(emit);
        }
    }

    /// Ends the plays that are over, in order.
    pub(super) fn finish(&mut self, events: &mut VecDeque<Event>, emit: &mut dyn Emit) {
        let (rate, tick) = (self.rate(), self.tick);
        let Self { state, known, session, operations, plays, control, .. } = self;
        // Asks as soon as the play is over, so that the answer comes with the last status.
        let is_over = |first: &&mut Active| !first.is_cut() && first.end().is_some_and(|end| tick >= end);
        if let Some(first) = plays.iter_mut().next().filter(is_over) {
            first.board().ends(tick, rate, || session.ask_board());
        }
        while let Some(first) = plays.iter().next() {
            // A play without strokes never starts: the counters at the next onset separate its neighbours.
            let later = || plays.iter().skip(1);
            let next_counters = later().find_map(Active::counters_at_onset);
            let Some((status, at)) = known.status else { return };
            let after = if first.is_cut() {
                let settled = !operations.is_in_flight()
                    && operations.is_empty()
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
                    session.distrust(Contradiction::Reports, &mut |event| events.push_back(event));
                }
                break;
            };
            let first = &mut plays[0];
            if first.phase() != Phase::Waiting && !first.board().ends(tick, rate, || session.ask_board()) {
                break;
            }
            // The estimates are those of the play's end: no burst of the next play counts yet.
            let end = if first.is_cut() { None } else { first.end() };
            control.reckon_to(end.map_or(tick, |end| end.max(first.last_end())));
            let over = match (first.cut_at(), first.started()) {
                (Some((_, over)), _) => over,
                (None, Some(onset)) => control.over_at(onset.actual, first.until(), None),
                (None, None) => None,
            };
            // Not yet: the device has lost the report of a cut.
            let over = over.filter(|&over| over <= tick);
            let ending = Ending {
                after: Some(next_counters.unwrap_or(after)),
                wire: session.traffic().bytes_out,
                offset: over.zip(session.clock().estimate()).map(|(over, clock)| Stamp::new(over, &clock)),
                cut: first.cut_at().map(|(at, _)| at),
                rest: control.rest_error_um(tick),
                estimated: false,
            };
            plays.close_first(ending, emit);
        }
        let over = plays.iter().next().is_some_and(|first| {
            first.is_cut() || (first.phase() == Phase::Streamed && first.end().is_some_and(|end| tick >= end))
        });
        if over || *state == State::Returning || operations.is_closing() {
            session.request_status();
        }
    }
}
