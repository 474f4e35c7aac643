//! The state of one play that the streamer has taken, and the account of its bursts.
//!
//! The streamer counts strokes planned, late and refused in [`Active`]; [`Active::close`] makes the [`Outcome`].
//!
//! Invariant: `planned = played + late + dropped + refused + replaced`. The device reports each late and each refused stroke, and counts
//! the bursts played between the play's onset and its end. The rest was dropped. An item has ended only once the device has accepted
//! or rejected all its strokes and is known to have come to the end of the last.

use crate::board::BoardAccount;
use crate::control::{Cutting, Span};
use crate::link::ClockEstimate;
use crate::queues::{At, End, Item, Offset, Onset, Outcome, Play, RestErrors, Stamp};
use crate::time::HostInstant;
use firmware_protocol::message::{Counters, Trigger};
use firmware_protocol::stroke::Stroke;
use firmware_protocol::tick::Tick;
use meissner_api::{BurstCounts, EndCause, LateCause, LateCounts, PulseCounts};
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
    /// The item whose strokes are being sent.
    sending: usize,
    /// The first item that is not known to have ended.
    ending: usize,
    /// The device has reported when it cut the play.
    cut_reported: bool,
    /// Strokes sent without a verdict.
    pub(super) undecided: u64,
    /// The end of the last stroke sent.
    pub(super) last_end: Tick,
    /// Why the play was cut, if it was.
    pub(super) cut: Option<EndCause>,
    /// The device's counters at the onset, once it has passed.
    pub(super) counters_at_onset: Option<Counters>,
    /// What the board's reports say of it.
    pub(super) board: BoardAccount,
    /// When the device cut it, once it has reported that, and when its last pulse was over.
    pub(super) cut_at: Option<(Cutting, Option<Tick>)>,
    actual_onset: Option<Onset>,
    rest_at_onset: Option<RestErrors>,
    planned_strokes: u64,
    planned_pulses: u64,
    late_strokes: u64,
    refused_strokes: u64,
    lateness: LateCounts,
    wire_from: u64,
}

/// What is known of a play at its end.
#[derive(Debug)]
pub(super) struct Ending {
    /// The device's counters after the play; `None` if there are none.
    pub(super) after: Option<Counters>,
    /// Bytes sent to the device so far.
    pub(super) wire: u64,
    /// When the last pulse was over.
    pub(super) offset: Option<Offset>,
    /// When it was cut, if it was.
    pub(super) cut: Option<Tick>,
    /// The rest errors.
    pub(super) rest: RestErrors,
    /// `after` is an estimate.
    pub(super) estimated: bool,
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
            sending: 0,
            ending: 0,
            cut_reported: false,
            undecided: 0,
            last_end: Tick(0),
            cut: None,
            counters_at_onset: None,
            board: BoardAccount::default(),
            cut_at: None,
            actual_onset: None,
            rest_at_onset: None,
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
        (self.sending, self.ending) = (0, 0);
        for (item, onset) in self.play.items.iter_mut().zip(self.play.strokes.onsets()) {
            *item = Item { onset, last_end: onset, ..Item::new(item.trigger) };
        }
        (self.planned_strokes, self.planned_pulses) = (0, 0);
        self.wire_from = wire;
    }

    /// The first tick after the play, if it has an end and an onset.
    pub(super) fn end(&self) -> Option<Tick> {
        Some(self.onset? + self.play.strokes.end()?)
    }

    /// The end of the play, by which position control knows its strokes; the last tick of all if it has no end.
    pub(super) fn until(&self) -> Tick {
        self.end().unwrap_or(Tick(u64::MAX))
    }

    /// The earliest tick at which a stroke of `motor` that is not sent yet may begin.
    pub(super) fn free_until(&self, motor: u8) -> Tick {
        let next = self.next.filter(|next| next.motor == motor).map(|next| next.up);
        let up = next.or_else(|| self.play.strokes.next_up(motor));
        up.or_else(|| self.end()).unwrap_or(self.last_end)
    }

    /// What the trigger output gives at the play's onset.
    pub(super) fn trigger(&self) -> Option<Trigger> {
        // A pause may come before the first item, which then has a mark of its own.
        let begins = self.play.items.first().filter(|item| Some(item.onset) == self.onset);
        begins.and_then(|item| item.trigger)
    }

    /// Goes on to the strokes of the next item; returns its trigger.
    pub(super) fn send_next_item(&mut self) -> Option<Trigger> {
        self.play.strokes.next_item();
        self.sending = self.play.strokes.item();
        self.play.items.get(self.sending).and_then(|item| item.trigger)
    }

    /// How many onsets of items are sent and still to come at `tick`. It counts no further than `most`.
    pub(super) fn onsets_ahead(&self, tick: Tick, most: usize) -> usize {
        let sent = self.play.items.iter().take(self.sending + 1).rev().take(most);
        sent.take_while(|item| item.onset >= tick).count()
    }

    /// The item that a stroke with this up tick belongs to.
    fn item_at(&mut self, up: Tick) -> Option<&mut Item> {
        let after = self.play.items.partition_point(|item| item.onset <= up);
        self.play.items.get_mut(after.saturating_sub(1))
    }

    /// The device has reported an onset, perhaps that of an item of this play.
    pub(super) fn reported(&mut self, onset: Stamp) {
        let found = self.play.items.binary_search_by_key(&onset.tick, |item| item.onset);
        if let Some(item) =
            found.ok().filter(|_| self.onset.is_some()).and_then(|at| self.play.items.get_mut(at))
        {
            item.began = Some(onset);
        }
    }

    /// Notes the ends of items, unless the play is cut: the device is known to have come to `known_to`.
    pub(super) fn note_ends(&mut self, known_to: Tick, clock: &ClockEstimate) {
        if self.cut.is_none() && !self.cut_reported {
            self.note_ends_until(known_to, clock);
        }
    }

    /// The device has reported a cut at `tick`. A report from before the onset concerns another play.
    pub(super) fn was_cut(&mut self, tick: Tick, clock: &ClockEstimate) {
        let concerned = self.onset.is_some_and(|onset| onset < tick);
        if concerned && !std::mem::replace(&mut self.cut_reported, true) {
            self.note_ends_until(tick, clock);
            let ended = self.play.items.iter_mut().take(self.ending);
            for item in ended.rev().take_while(|item| item.last_end > tick) {
                item.ended = None;
            }
        }
    }

    fn note_ends_until(&mut self, tick: Tick, clock: &ClockEstimate) {
        let begun = self.play.items.get(self.sending).is_some_and(|item| item.planned > 0);
        let all = begun && self.next.is_none() && self.play.strokes.next_onset().is_some();
        let sent = match self.phase {
            Phase::Streamed => self.play.items.len(),
            _ => self.sending + usize::from(all),
        };
        let items = self.play.items.iter_mut().take(sent).skip(self.ending);
        for item in items.take_while(|item| item.undecided == 0 && item.last_end <= tick) {
            item.ended = Some(Stamp::new(item.last_end, clock));
            self.ending += 1;
        }
    }

    /// Whether the client asked for an onset.
    pub(super) fn is_fixed(&self) -> bool {
        self.play.at != At::Next
    }

    /// Counts a stroke sent, or too late to be sent.
    pub(super) fn plan(&mut self, stroke: &Stroke, sent: bool) {
        self.undecided += u64::from(sent);
        self.planned_strokes += 1;
        self.planned_pulses += u64::from(stroke.up_pulses) + u64::from(stroke.down_pulses);
        self.last_end = self.last_end.max(stroke.end());
        if let Some(item) = self.play.items.get_mut(self.sending) {
            item.planned += 1;
            item.undecided += u32::from(sent);
        }
    }

    /// The device has accepted or rejected a stroke sent.
    pub(super) fn decided(&mut self, stroke: &Stroke, accepted: bool) {
        self.undecided = self.undecided.saturating_sub(1);
        let Some(item) = self.item_at(stroke.up) else { return };
        item.undecided = item.undecided.saturating_sub(1);
        if accepted {
            // Verdicts come in the order of the strokes.
            item.first_up.get_or_insert(stroke.up);
            item.last_end = item.last_end.max(stroke.end());
        }
    }

    /// The device has refused, as it began, a stroke that it had accepted. `others` gives the first start and the last end of the
    /// other strokes of the item.
    pub(super) fn refused_as_begun(&mut self, up: Tick, others: impl FnOnce(Span) -> [Option<Tick>; 2]) {
        self.refused(up);
        let play = self.until();
        let after = self.play.items.partition_point(|item| item.onset <= up);
        let until = self.play.items.get(after).map_or(play, |next| next.onset);
        let Some(item) = self.play.items.get_mut(after.saturating_sub(1)) else { return };
        let [first, last] = others(Span { from: item.onset, until: until.min(item.last_end), play });
        if item.first_up == Some(up) {
            item.first_up = first;
        }
        item.last_end = last.unwrap_or(item.onset);
    }

    /// Counts a late stroke; returns the counts so far.
    pub(super) fn late(&mut self, up: Tick, late_ms: f64, cause: LateCause) -> LateCounts {
        self.late_strokes += 1;
        if let Some(item) = self.item_at(up) {
            item.late += 1;
        }
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

    pub(super) fn refused(&mut self, up: Tick) {
        self.refused_strokes += 1;
        if let Some(item) = self.item_at(up) {
            item.refused += 1;
        }
    }

    /// The onset has passed, with these rest errors.
    pub(super) fn began(&mut self, onset: Onset, counters: Counters, rest: RestErrors) {
        self.counters_at_onset = Some(counters);
        self.actual_onset = Some(onset);
        self.rest_at_onset = Some(rest);
    }

    pub(super) fn started(&self) -> Option<Onset> {
        self.actual_onset
    }

    /// Closes the account with what is known at its end.
    pub(super) fn close(self, ending: Ending) -> (u64, Outcome) {
        let Ending { after, wire, offset, cut, rest, estimated } = ending;
        let since = |now: fn(&Counters) -> u64| match (&after, &self.counters_at_onset) {
            (Some(after), Some(counters_at_onset)) => now(after).saturating_sub(now(counters_at_onset)),
            _ => 0,
        };
        let planned = 2 * self.planned_strokes;
        let (late, refused) = (2 * self.late_strokes, 2 * self.refused_strokes);
        let replaced = since(|counters| counters.replaced).min(planned.saturating_sub(late + refused));
        let played = since(|counters| counters.played).min(planned.saturating_sub(late + refused + replaced));
        let dropped = planned.saturating_sub(late + refused + replaced + played);
        let bursts = BurstCounts {
            planned,
            played,
            late,
            dropped,
            refused,
            replaced,
            amended: since(|counters| counters.amended).min(played),
        };
        let outcome = Outcome {
            end: End::by(self.cut.as_ref()),
            cause: self.cut,
            onset: self.actual_onset,
            offset,
            cut_after: cut.zip(self.actual_onset).map(|(at, onset)| at - onset.actual),
            bursts,
            pulses: PulseCounts { planned: self.planned_pulses, played: since(|counters| counters.pulses) },
            estimated: estimated && self.phase != Phase::Waiting,
            lateness: self.lateness,
            board: self.board.close(),
            wire_bytes: if self.onset.is_some() { wire.saturating_sub(self.wire_from) } else { 0 },
            rest_at_onset: self.rest_at_onset,
            rest_at_end: rest,
            play: self.play,
        };
        (outcome.play.id, outcome)
    }
}
