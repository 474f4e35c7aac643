//! The state of one play that the streamer has taken, and the account of its bursts.
//!
//! The streamer counts strokes planned, late and refused in [`Active`]; [`Active::close`] makes the [`Outcome`].
//!
//! Invariant: `planned = played + late + dropped + refused`. The device reports each late and each refused stroke, and counts
//! the bursts played between the play's onset and its end. The rest was dropped.

use crate::queues::{At, End, Onset, Outcome, Play};
use crate::time::HostInstant;
use firmware_protocol::message::Counters;
use firmware_protocol::stroke::{MOTORS, Stroke};
use firmware_protocol::tick::Tick;
use meissner_api::{BurstCounts, LateCause, LateCounts, PulseCounts};
use std::time::Duration;

/// The progress of a play.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Nothing is sent.
    Waiting,
    /// The first frame is sent and waits for the device's verdict.
    Offered,
    /// The device has accepted the onset.
    Streaming,
    /// All strokes are sent.
    Streamed,
}

#[derive(Debug)]
pub(super) struct Active {
    pub(super) play: Box<Play>,
    pub(super) phase: Phase,
    /// When the client issued the command.
    pub(super) issued_at: HostInstant,
    /// The tick of pattern time 0, once chosen.
    pub(super) onset: Option<Tick>,
    /// The onset first chosen or asked for.
    pub(super) requested: Option<Tick>,
    /// How far ahead of now the next onset is tried.
    pub(super) margin: Duration,
    /// The next stroke to send.
    pub(super) next: Option<Stroke>,
    /// Strokes sent without a verdict.
    pub(super) undecided: u64,
    /// The end of the last stroke sent.
    pub(super) last_end: Tick,
    /// How and why it was cut, if it was.
    pub(super) cut: Option<(End, &'static str)>,
    /// The device's counters at the onset, once it has passed.
    pub(super) counters_at_onset: Option<Counters>,
    actual_onset: Option<Onset>,
    planned_strokes: u64,
    planned_pulses: u64,
    late_strokes: u64,
    refused_strokes: u64,
    lateness: LateCounts,
    wire_from: u64,
}

/// The first onset is tried this far ahead: the render horizon, the link and a wake-up.
pub(super) const FIRST_MARGIN: Duration = Duration::from_millis(3);

impl Active {
    pub(super) fn new(
        play: Box<Play>,
        issued_at: HostInstant,
        requested: Option<Tick>,
        margin: Duration,
    ) -> Self {
        Self {
            play,
            phase: Phase::Waiting,
            issued_at,
            onset: requested,
            requested,
            margin,
            next: None,
            undecided: 0,
            last_end: Tick(0),
            cut: None,
            counters_at_onset: None,
            actual_onset: None,
            planned_strokes: 0,
            planned_pulses: 0,
            late_strokes: 0,
            refused_strokes: 0,
            lateness: LateCounts::default(),
            wire_from: 0,
        }
    }

    /// Starts to stream at `onset`, for the first time or again.
    pub(super) fn offer(&mut self, onset: Tick, wire: u64) {
        self.phase = Phase::Offered;
        self.onset = Some(onset);
        self.requested = self.requested.or(Some(onset));
        self.play.strokes.begin(onset);
        (self.next, self.undecided, self.last_end) = (None, 0, onset);
        (self.planned_strokes, self.planned_pulses) = (0, 0);
        self.wire_from = wire;
    }

    /// The first tick after the play, if it has an end and an onset.
    pub(super) fn end(&self) -> Option<Tick> {
        Some(self.onset? + self.play.strokes.end()?)
    }

    /// The earliest tick at which a stroke of `motor` that is not sent yet may begin.
    pub(super) fn free_until(&self, motor: u8) -> Tick {
        let next = self.next.filter(|next| next.motor == motor).map(|next| next.up);
        let up = next.or_else(|| self.play.strokes.next_up(motor));
        up.or_else(|| self.end()).unwrap_or(self.last_end)
    }

    /// Whether the client asked for an onset.
    pub(super) fn is_fixed(&self) -> bool {
        self.play.at != At::Next
    }

    /// Counts a stroke sent, or too late to be sent.
    pub(super) fn plan(&mut self, stroke: &Stroke) {
        self.planned_strokes += 1;
        self.planned_pulses += u64::from(stroke.up_pulses) + u64::from(stroke.down_pulses);
        self.last_end = self.last_end.max(stroke.end());
    }

    /// Counts a late stroke; returns the counts so far.
    pub(super) fn late(&mut self, late_ms: f64, cause: LateCause) -> LateCounts {
        self.late_strokes += 1;
        self.lateness.worst_ms = self.lateness.worst_ms.max(late_ms);
        match cause {
            LateCause::Host => self.lateness.host += 1,
            LateCause::Link => self.lateness.link += 1,
            LateCause::Device => self.lateness.device += 1,
        }
        self.lateness
    }

    /// Counts all strokes as late: the device refused the onset.
    pub(super) fn late_as_a_whole(&mut self, late_ms: f64) {
        self.late_strokes = self.planned_strokes;
        self.lateness.link = self.planned_strokes;
        self.lateness.worst_ms = late_ms;
    }

    pub(super) fn refused(&mut self) {
        self.refused_strokes += 1;
    }

    /// The onset has passed.
    pub(super) fn began(&mut self, onset: Onset, counters: Counters) {
        self.counters_at_onset = Some(counters);
        self.actual_onset = Some(onset);
    }

    pub(super) fn started(&self) -> Option<Onset> {
        self.actual_onset
    }

    /// Closes the account with the device's counters after the play; `None` if there are none.
    pub(super) fn close(
        self,
        after: Option<Counters>,
        wire: u64,
        rest_error_um: [f32; MOTORS],
    ) -> (u64, Outcome) {
        let since = |now: fn(&Counters) -> u64| match (&after, &self.counters_at_onset) {
            (Some(after), Some(counters_at_onset)) => now(after).saturating_sub(now(counters_at_onset)),
            _ => 0,
        };
        let planned = 2 * self.planned_strokes;
        let (late, refused) = (2 * self.late_strokes, 2 * self.refused_strokes);
        let played = since(|counters| counters.played).min(planned.saturating_sub(late + refused));
        let dropped = planned.saturating_sub(late + refused + played);
        let (end, cause) = self.cut.map_or((End::Done, None), |(end, cause)| (end, Some(cause)));
        let bursts = BurstCounts {
            planned,
            played,
            late,
            dropped,
            refused,
            amended: since(|counters| counters.amended).min(played),
        };
        let outcome = Outcome {
            end,
            cause,
            onset: self.actual_onset,
            bursts,
            pulses: PulseCounts { planned: self.planned_pulses, played: since(|counters| counters.pulses) },
            lateness: self.lateness,
            wire_bytes: if self.onset.is_some() { wire.saturating_sub(self.wire_from) } else { 0 },
            rest_error_um,
            play: self.play,
        };
        (outcome.play.id, outcome)
    }
}
