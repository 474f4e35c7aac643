//! The account of a play's moves: planned, late and refused ones as the streamer counts them, the others as the device counts.
//!
//! The streamer counts each step ([`Account::plan`], [`Account::late`], `refused`) and notes the device's counters at the onset
//! (`begun`). [`Account::bursts`] closes it with the counters after the play.
//!
//! Invariant: `planned = played + late + dropped + refused + replaced`. The device reports each late and each refused move, and
//! counts those played between the play's onset and its end. The rest was dropped.

use crate::board::BoardAccount;
use crate::queues::{Onset, RestErrors};
use firmware_protocol::message::Counters;
use firmware_protocol::tick::Tick;
use meissner_api::{BurstCounts, LateCause, LateCounts, PulseCounts};
use meissner_array::strokes::Step;

/// What is known once the onset has passed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Begun {
    pub(super) onset: Onset,
    /// The device's counters at the onset.
    pub(super) counters: Counters,
    pub(super) rest: RestErrors,
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Account {
    pub(super) begun: Option<Begun>,
    pub(super) board: BoardAccount,
    planned: u64,
    planned_pulses: u64,
    late: u64,
    /// Moves that the device has refused so far.
    pub(super) refused: u64,
    /// Steps planned.
    steps: u64,
    /// Steps sent without a verdict.
    pub(super) undecided: u64,
    /// The end of the last step planned.
    pub(super) last_end: Tick,
    pub(super) lateness: LateCounts,
    /// Bytes sent to the device before the play.
    wire_from: u64,
}

impl Account {
    /// The play is offered, perhaps again, from this onset on: all its steps will be planned.
    pub(super) const fn offer(&mut self, onset: Tick, wire: u64) {
        (self.planned, self.steps, self.planned_pulses, self.undecided) = (0, 0, 0, 0);
        (self.last_end, self.wire_from) = (onset, wire);
    }

    /// Counts a step that is `sent`, or too late to be sent.
    pub(super) fn plan(&mut self, step: &Step, sent: bool) {
        self.steps += 1;
        self.undecided += u64::from(sent);
        self.last_end = self.last_end.max(step.end());
        self.planned += step.moves() as u64;
        self.planned_pulses += u64::from(step.pulses());
    }

    /// Counts a late step of so many moves; returns the counts so far.
    pub(super) const fn late(&mut self, moves: u64, late_ms: f64, cause: LateCause) -> LateCounts {
        self.late += moves;
        self.lateness.worst_ms = self.lateness.worst_ms.max(late_ms);
        match cause {
            LateCause::Host => self.lateness.host += 1,
            LateCause::Link => self.lateness.link += 1,
            LateCause::Device => self.lateness.device += 1,
        }
        self.lateness
    }

    /// Counts all steps as late: the device refused the onset.
    pub(super) const fn all_late(&mut self, late_ms: f64) {
        (self.late, self.lateness.link) = (self.planned, self.steps);
        self.lateness.worst_ms = late_ms;
    }

    /// Bytes sent since the offer, of `wire` so far.
    pub(super) const fn wire_bytes(&self, wire: u64) -> u64 {
        wire.saturating_sub(self.wire_from)
    }

    /// What a counter has counted since the onset; nothing if either end is not known.
    fn since(&self, after: Option<&Counters>, counter: fn(&Counters) -> u64) -> u64 {
        let counts = after.zip(self.begun.as_ref());
        counts.map_or(0, |(after, begun)| counter(after).saturating_sub(counter(&begun.counters)))
    }

    /// The bursts, with the device's counters `after` the play.
    pub(super) fn bursts(&self, after: Option<&Counters>) -> BurstCounts {
        let since = |counter| self.since(after, counter);
        let Self { planned, late, refused, .. } = *self;
        let replaced = since(|counters| counters.replaced).min(planned.saturating_sub(late + refused));
        let played = since(|counters| counters.played).min(planned.saturating_sub(late + refused + replaced));
        let dropped = planned.saturating_sub(late + refused + replaced + played);
        let amended = since(|counters| counters.amended).min(played);
        let shortened = since(|counters| counters.shortened).min(played);
        BurstCounts { planned, played, late, dropped, refused, replaced, amended, shortened }
    }

    /// The pulses, with the device's counters `after` the play.
    pub(super) fn pulses(&self, after: Option<&Counters>) -> PulseCounts {
        PulseCounts { planned: self.planned_pulses, played: self.since(after, |counters| counters.pulses) }
    }
}
