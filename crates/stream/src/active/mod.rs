//! The state of one play that the streamer has taken, and the account of its bursts.
//!
//! The streamer tells [`Active`] what it sends and what the device reports; [`Active::close`] makes the [`Outcome`]. Parts own what
//! they count: `account` has what became of the strokes. The first cause of a cut stays, and so does the device's first report of it,
//! which may come before the cause or after it. A step taken from the source is the next one until it is planned or put back.
//!
//! Invariant: an item has ended only once the device has accepted or rejected all its strokes and is known to have come to the end
//! of the last, or of a blank item. A play that waits has an onset only if its client asked for one.

mod account;

use crate::board::BoardAccount;
use crate::control::Span;
use crate::link::ClockEstimate;
use crate::queues::{At, Edge, End, Item, Onset, Outcome, Play, RestErrors, Stamp};
use crate::time::HostInstant;
use account::{Account, Begun};
use firmware_protocol::array::MotorSet;
use firmware_protocol::message::{Counters, Trigger};
use firmware_protocol::tick::Tick;
use meissner_api::{EndCause, LateCause, LateCounts};
use meissner_array::strokes::{LiveStrokes, Step, StrokesError};
use meissner_array::units::TickRate;
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
    play: Box<Play>,
    phase: Phase,
    /// When the client issued the command.
    issued_at: HostInstant,
    /// The tick of pattern time 0, once chosen.
    onset: Option<Tick>,
    /// The onset first chosen or asked for.
    requested: Option<Tick>,
    /// How far ahead of now the next onset is tried.
    margin: Duration,
    /// Edges of the trigger input from this tick on may start it.
    taken_at: Tick,
    started_by: Option<Edge>,
    stopped_by: Option<Edge>,
    /// The first item that is not known to have ended.
    ending: usize,
    /// The next step, once it is taken from the source.
    next: Option<Step>,
    /// Why it was cut.
    cause: Option<EndCause>,
    /// The device has reported a cut.
    cut_reported: bool,
    /// When the device cut the play, and when its last pulse was over.
    cut_at: Option<(Tick, Option<Tick>)>,
    account: Account,
}

/// What is known of a play at its end.
#[derive(Debug)]
pub(super) struct Ending {
    /// The device's counters after the play; `None` if there are none.
    pub(super) after: Option<Counters>,
    /// Bytes sent to the device so far.
    pub(super) wire: u64,
    /// When the last pulse was over.
    pub(super) offset: Option<Stamp>,
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
        (taken_at, requested): (Tick, Option<Tick>),
        margin: Duration,
    ) -> Self {
        Self {
            play,
            phase: Phase::Waiting,
            issued_at,
            onset: requested,
            requested,
            margin,
            taken_at,
            started_by: None,
            stopped_by: None,
            ending: 0,
            next: None,
            cause: None,
            cut_reported: false,
            cut_at: None,
            account: Account::default(),
        }
    }

    fn rate(&self) -> TickRate {
        self.play.strokes.array().rate()
    }

    pub(super) fn play(&self) -> &Play {
        &self.play
    }

    pub(super) const fn phase(&self) -> Phase {
        self.phase
    }

    pub(super) const fn onset(&self) -> Option<Tick> {
        self.onset
    }

    /// The drives that may change, if this is a live play.
    pub(super) fn live_strokes(&mut self) -> Option<&mut LiveStrokes> {
        self.play.strokes.live()
    }

    /// What the board's reports say of it.
    pub(super) const fn board(&mut self) -> &mut BoardAccount {
        &mut self.account.board
    }

    /// Whether it waits for an edge of the trigger input.
    pub(super) fn waits_for_edge(&self) -> bool {
        let waits = matches!(self.play.at, At::Edge(_)) && self.phase == Phase::Waiting;
        waits && self.started_by.is_none() && !self.is_cut()
    }

    /// Takes an edge that came while it waited for one: its onset follows from it. Returns whether it did.
    pub(super) fn take_edge(&mut self, edge: Edge) -> bool {
        let At::Edge(delay_ns) = self.play.at else { return false };
        let takes = self.waits_for_edge() && edge.at.tick >= self.taken_at;
        if takes {
            self.onset = Some(edge.at.tick + edge_delay(self.rate(), delay_ns));
            (self.requested, self.started_by) = (self.onset, Some(edge));
        }
        takes
    }

    /// Whether it runs at this tick, as far as is known.
    pub(super) fn runs_at(&self, tick: Tick) -> bool {
        let begun = self.phase != Phase::Waiting && self.onset.is_some_and(|onset| onset <= tick);
        begun && tick < self.until() && self.cut_at.is_none_or(|(at, _)| tick < at)
    }

    /// Whether an edge at `tick` stops it: the first one after its onset, if the play asks for that and is not over `now`.
    pub(super) fn stops_by_edge(&self, tick: Tick, now: Tick) -> bool {
        // The report of the onset may come after that of the edge: what counts is the onset that the device has accepted.
        let accepted = matches!(self.phase, Phase::Streaming | Phase::Streamed);
        let begun = accepted && self.onset.is_some_and(|onset| onset < tick);
        self.play.stop_on_edge && begun && now < self.until() && !self.is_cut()
    }

    /// Cuts it because of an edge.
    pub(super) fn stop_by(&mut self, edge: Edge) {
        self.stopped_by = Some(edge);
        self.cut(EndCause::Edge);
    }

    /// The earliest onset that can be tried at `tick`.
    pub(super) fn soonest(&self, tick: Tick) -> Tick {
        tick + self.rate().duration_to_ticks(self.margin)
    }

    /// Starts to stream at `onset`, for the first time or again.
    pub(super) fn offer(&mut self, onset: Tick, wire: u64) {
        self.phase = Phase::Offered;
        self.onset = Some(onset);
        self.requested = self.requested.or(Some(onset));
        self.play.strokes.begin(onset);
        (self.next, self.ending) = (None, 0);
        self.play.pins.fill(None);
        let strokes = &self.play.strokes;
        for ((number, item), onset) in self.play.items.iter_mut().enumerate().zip(strokes.onsets()) {
            let last_end = strokes.blank_until(number).unwrap_or(onset);
            *item = Item { onset, last_end, ..Item::new(item.trigger) };
        }
        self.account.offer(onset, wire);
    }

    /// The device has accepted the onset.
    pub(super) const fn onset_accepted(&mut self) {
        self.phase = Phase::Streaming;
    }

    /// The device has refused the onset: it had rendered up to `rendered`. The next is tried farther ahead, unless the client asked for
    /// this one or the margin exceeds `longest`. Returns the onset.
    pub(super) fn onset_refused(&mut self, rendered: Tick, longest: Duration) -> Option<Tick> {
        let onset = self.onset.take();
        self.phase = Phase::Waiting;
        self.account.undecided = 0;
        self.margin *= 2;
        if self.play.at != At::Next || self.margin > longest {
            let late = onset.map_or(0, |onset| rendered - onset);
            self.account.all_late(self.rate().ticks_to_ms(late));
            self.cut(EndCause::OnsetMissed);
        }
        onset
    }

    /// All strokes are sent.
    pub(super) const fn all_sent(&mut self) {
        self.phase = Phase::Streamed;
    }

    /// The first tick after the play, if it has an end and an onset.
    pub(super) fn end(&self) -> Option<Tick> {
        Some(self.onset? + self.play.strokes.end()?)
    }

    /// The end of the play, the last tick of all if it has no end.
    pub(super) fn until(&self) -> Tick {
        self.end().unwrap_or(Tick(u64::MAX))
    }

    /// The end of the last stroke sent.
    pub(super) const fn last_end(&self) -> Tick {
        self.account.last_end
    }

    /// Whether all strokes are sent, and the device has accepted or rejected each.
    pub(super) fn is_decided(&self) -> bool {
        self.phase == Phase::Streamed && self.account.undecided == 0
    }

    /// The earliest tick at which a stroke of `motor` that is not sent yet may begin.
    pub(super) fn free_until(&self, motor: u8) -> Tick {
        let next = self.next.filter(|next| next.motor() == motor).map(|next| next.begin());
        let up = next.or_else(|| self.play.strokes.next_up(motor));
        up.or_else(|| self.end()).unwrap_or(self.last_end())
    }

    /// The next stroke to send; `None`: there is none for now.
    pub(super) fn next_step(&mut self) -> Result<Option<Step>, StrokesError> {
        if self.next.is_none() {
            self.next = self.play.strokes.next().transpose()?;
        }
        Ok(self.next)
    }

    /// Puts the next stroke back, if this is a live play: its drive changes.
    pub(super) fn put_back_next(&mut self) {
        if let Some(strokes) = self.play.strokes.live()
            && let Some(next) = self.next.take()
        {
            strokes.put_back(&next);
        }
    }

    /// When the next item begins, if all strokes of the present one are sent.
    pub(super) fn next_onset(&self) -> Option<Tick> {
        if self.next.is_some() { None } else { self.play.strokes.next_onset() }
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
        self.play.items.get(self.play.strokes.item()).and_then(|item| item.trigger)
    }

    /// How many onsets of items are sent and still to come at `tick`. It counts no further than `most`.
    pub(super) fn onsets_ahead(&self, tick: Tick, most: usize) -> usize {
        let sent = self.play.items.iter().take(self.play.strokes.item() + 1).rev().take(most);
        sent.take_while(|item| item.onset >= tick).count()
    }

    /// The number of the item that a step of this motor belongs to: the last one before it that drives the motor.
    fn item_of(&self, motor: u8, begin: Tick) -> Option<usize> {
        let after = self.play.items.partition_point(|item| item.onset <= begin);
        (0..after).rev().find(|&item| self.play.strokes.item_drives(item, motor))
    }

    /// The item that a step of this motor belongs to.
    fn item_at(&mut self, motor: u8, begin: Tick) -> Option<&mut Item> {
        let item = self.item_of(motor, begin)?;
        self.play.items.get_mut(item)
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
        if self.cause.is_none() && !self.cut_reported {
            self.note_ends_until(known_to, clock);
        }
    }

    /// The device has reported a cut at `tick`. A report from before the onset concerns another play.
    pub(super) fn was_cut(&mut self, tick: Tick, clock: &ClockEstimate) {
        let concerned = self.onset.is_some_and(|onset| onset < tick);
        if concerned && !std::mem::replace(&mut self.cut_reported, true) {
            self.note_ends_until(tick, clock);
            for item in self.play.items.iter_mut().filter(|item| item.last_end > tick) {
                item.ended = None;
            }
        }
    }

    fn note_ends_until(&mut self, tick: Tick, clock: &ClockEstimate) {
        let sent = match self.phase {
            Phase::Streamed => self.play.items.len(),
            _ => self.play.strokes.item() + 1,
        };
        let pending = self.next.and_then(|step| self.item_of(step.motor(), step.begin()));
        // Items that overlap need not end in their order.
        for number in self.ending..sent.min(self.play.items.len()) {
            let is_sent = self.phase == Phase::Streamed
                || (pending != Some(number) && self.play.strokes.item_is_over(number));
            let item = &mut self.play.items[number];
            if item.ended.is_none() && is_sent && item.undecided == 0 && item.last_end <= tick {
                item.ended = Some(Stamp::new(item.last_end, clock));
            }
            self.ending += usize::from(number == self.ending && item.ended.is_some());
        }
    }

    /// Cuts the play for this cause, unless it is cut.
    pub(super) fn cut(&mut self, cause: EndCause) {
        self.cause.get_or_insert(cause);
    }

    /// Cuts the play before anything of it is sent: it has no onset.
    pub(super) fn cut_unsent(&mut self, cause: EndCause) {
        self.cut(cause);
        self.onset = None;
    }

    pub(super) const fn is_cut(&self) -> bool {
        self.cause.is_some()
    }

    /// The device cut the play at this time, and its last pulse was over at `over`. The first report stays.
    pub(super) fn note_cut_at(&mut self, at: Tick, over: Option<Tick>) {
        self.cut_at.get_or_insert((at, over));
    }

    /// The device cut the return at this time, too.
    pub(super) fn note_return_cut_at(&mut self, at: Tick) {
        if let Some((_, Some(over))) = &mut self.cut_at {
            *over = at.min(*over);
        }
    }

    /// When the device cut the play, once it has reported that, and when its last pulse was over.
    pub(super) const fn cut_at(&self) -> Option<(Tick, Option<Tick>)> {
        self.cut_at
    }

    /// Counts a step sent, or too late to be sent.
    pub(super) fn plan(&mut self, step: &Step, sent: bool) {
        self.next = None;
        self.account.plan(step, sent);
        if let Some(item) = self.item_at(step.motor(), step.begin()) {
            item.planned += 1;
            item.undecided += u32::from(sent);
        }
    }

    /// The device has accepted or rejected a step sent.
    pub(super) fn decided(&mut self, step: &Step, accepted: bool) {
        self.account.undecided = self.account.undecided.saturating_sub(1);
        if accepted
            && step.bursts().next().is_some()
            && let Some(pin) = self.play.pins.get_mut(usize::from(step.motor()))
        {
            // Verdicts come in the order of the steps.
            let first = pin.map_or(step.begin(), |[first, _]| first);
            *pin = Some([first, pin.map_or(step.end(), |[_, end]| end.max(step.end()))]);
        }
        let Some(item) = self.item_at(step.motor(), step.begin()) else { return };
        item.undecided = item.undecided.saturating_sub(1);
        if accepted {
            // Verdicts come in the order of the steps.
            item.first_up.get_or_insert(step.begin());
            item.last_end = item.last_end.max(step.end());
        }
    }

    /// The device has refused, as it began, a stroke that it had accepted. `queued` is the first start and the last end of what its motor
    /// still has, and `others` gives those of the other strokes of the item.
    pub(super) fn refused_as_begun(
        &mut self,
        (motor, up): (u8, Tick),
        moves: u64,
        queued: [Option<Tick>; 2],
        others: impl FnOnce(Span) -> [Option<Tick>; 2],
    ) {
        self.refused(motor, up, moves);
        if let Some(pin) = self.play.pins.get_mut(usize::from(motor))
            && let Some([first, _]) = *pin
        {
            let first = if first == up { queued[0] } else { Some(first) };
            *pin = first.map(|first| [first, queued[1].unwrap_or(up)]);
        }
        let Some(number) = self.item_of(motor, up) else { return };
        let strokes = &self.play.strokes;
        let own = strokes.motors().filter(|motor| strokes.item_drives(number, *motor));
        let motors = MotorSet::from_bits(own.fold(0, |motors, motor| motors | 1 << motor));
        let Some(item) = self.play.items.get_mut(number) else { return };
        let [first, last] = others(Span { from: item.onset, until: item.last_end, motors });
        if item.first_up == Some(up) {
            item.first_up = first;
        }
        item.last_end = last.unwrap_or(item.onset);
    }

    /// Counts a late step; returns the counts so far.
    pub(super) fn late(&mut self, step: &Step, late_ms: f64, cause: LateCause) -> LateCounts {
        if let Some(item) = self.item_at(step.motor(), step.begin()) {
            item.late += 1;
        }
        self.account.late(step.moves() as u64, late_ms, cause)
    }

    /// The moves that the device has refused so far.
    pub(super) const fn refused_so_far(&self) -> u64 {
        self.account.refused
    }

    /// Counts a refused step of so many moves that begins at this tick.
    pub(super) fn refused(&mut self, motor: u8, up: Tick, moves: u64) {
        self.account.refused += moves;
        if let Some(item) = self.item_at(motor, up) {
            item.refused += 1;
        }
    }

    /// The onset has passed, with these counters of the device and these rest errors.
    pub(super) fn began(&mut self, stamp: Stamp, counters: Counters, rest: RestErrors) -> Onset {
        let Stamp { tick, at, uncertainty_ns } = stamp;
        let latency_ns = at.since(self.issued_at).as_nanos() as u64;
        let requested = self.requested.unwrap_or(tick);
        let onset = Onset { requested, actual: tick, at, uncertainty_ns, latency_ns };
        self.account.begun = Some(Begun { onset, counters, rest });
        onset
    }

    /// The onset, once it has passed.
    pub(super) fn started(&self) -> Option<Onset> {
        self.account.begun.as_ref().map(|begun| begun.onset)
    }

    /// The device's counters at the onset, once it has passed.
    pub(super) fn counters_at_onset(&self) -> Option<Counters> {
        self.account.begun.as_ref().map(|begun| begun.counters)
    }

    /// Closes the account with what is known at its end.
    pub(super) fn close(self, ending: Ending) -> (u64, Outcome) {
        let Ending { after, wire, offset, cut, rest, estimated } = ending;
        let Self { mut play, phase, onset, account, cause, started_by, stopped_by, .. } = self;
        if let Some(cut) = cut {
            for pin in &mut play.pins {
                *pin = pin.filter(|[first, _]| *first < cut).map(|[first, end]| [first, end.min(cut)]);
            }
        }
        let board = account.board.close();
        let begun = account.begun.as_ref();
        let started = begun.map(|begun| begun.onset);
        let outcome = Outcome {
            end: End::by(cause.as_ref()),
            cause,
            onset: started,
            started_by,
            stopped_by,
            offset,
            cut_after: cut.zip(started).map(|(at, onset)| at - onset.actual),
            bursts: account.bursts(after.as_ref()),
            pulses: account.pulses(after.as_ref()),
            estimated: estimated && phase != Phase::Waiting,
            lateness: account.lateness,
            board,
            wire_bytes: if onset.is_some() { account.wire_bytes(wire) } else { 0 },
            rest_at_onset: begun.map(|begun| begun.rest),
            rest_at_end: rest,
            play,
        };
        (outcome.play.id, outcome)
    }
}

/// The delay from an edge to the onset, ticks.
pub(super) fn edge_delay(rate: TickRate, delay_ns: u64) -> u64 {
    rate.seconds_to_ticks(delay_ns as f64 / 1e9)
}
