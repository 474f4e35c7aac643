//! The streamer's decisions: executes commands, sends strokes, handles the device's reports and ends plays.
//!
//! Its owner calls [`Streamer::execute`] with requests and [`Streamer::receive`] with bytes, then [`Streamer::step`] and
//! [`Streamer::transmit`]. `commands` executes, and `events` handles reports. Parts own what they decide: `plays` the plays and their
//! accounts, `feed` which strokes are sent, `live` the updates of live plays, `operations` the commands under way, `latch` the
//! emergency stop, `known` what the device said, `homing` the way back to rest, `reports` when a snapshot is due. `connected` is
//! what feed and live work on.
//!
//! Invariant: each play taken ends with exactly one [`StreamEvent::PlayEnded`], and each request with a ticket gets exactly
//! one answer. Nothing here allocates, except for a new session.

mod commands;
mod connected;
mod events;
mod feed;
mod homing;
mod known;
mod latch;
mod live;
mod operations;
mod plays;
mod reports;

use crate::active::{Active, Phase};
use crate::control::PositionControl;
use crate::link::{Budget, Event, LineRate, Session};
use crate::queues::{CommandError, Emit, Pins, Snapshot, StreamEvent};
use crate::settings::Settings;
use crate::time::HostInstant;
use connected::Connected;
use feed::Feed;
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::{Cause, Counters, Op, State, Status};
use firmware_protocol::tick::Tick;
use homing::Homing;
pub use homing::longest_homing_s;
use known::Known;
use latch::Latch;
use live::Live;
use meissner_api::EndCause;
use meissner_array::spec::Array;
use meissner_array::units::TickRate;
use operations::Operations;
use plays::Plays;
use reports::Reports;
use std::collections::VecDeque;
use std::time::Duration;

/// How often the streamer wakes up while anything is going on.
const BUSY_EVERY: Duration = Duration::from_millis(1);
/// Interval of snapshots while playing.
const SNAPSHOT_EVERY: Duration = Duration::from_millis(100);
/// Interval of keep-alives while disarmed.
const IDLE_PING: Duration = Duration::from_secs(1);

/// A command's result: refused, done at once (`None`), or an operation for the device.
type OpResult = Result<Option<Op>, CommandError>;

/// The streamer of one device.
#[derive(Debug)]
pub struct Streamer {
    settings: Settings,
    session: Option<Session>,
    events: VecDeque<Event>,
    known: Known,
    latch: Latch,
    operations: Operations,
    disconnect_reason: Option<EndCause>,
    plays: Plays,
    control: PositionControl,
    /// Since when pins stand above rest that a cut has left there.
    standing_since: Option<HostInstant>,
    feed: Feed,
    homing: Homing,
    live: Live,
    reports: Reports,
}

impl Streamer {
    /// A streamer without a device.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            session: None,
            events: VecDeque::with_capacity(4096),
            known: Known::default(),
            latch: Latch::default(),
            operations: Operations::new(),
            disconnect_reason: None,
            plays: Plays::new(),
            control: PositionControl::new(&settings),
            standing_since: None,
            feed: Feed::default(),
            homing: Homing::default(),
            live: Live::default(),
            reports: Reports::new(settings.array),
        }
    }

    /// A device was opened: starts a session with this random id.
    pub fn connect(&mut self, now: HostInstant, id: u32, rate: LineRate, emit: &mut dyn Emit) {
        self.disconnect(now, EndCause::AnotherDevice, emit);
        self.session = Some(Session::new(self.array(), id, rate, now));
    }

    const fn array(&self) -> Array {
        self.settings.array
    }

    fn rate(&self) -> TickRate {
        self.array().rate()
    }

    /// Refuses what is for another array.
    fn check_array(&self, found: Array) -> Result<(), CommandError> {
        let array = self.array();
        if found == array { Ok(()) } else { Err(CommandError::OtherArray { found, array }) }
    }

    /// The device is gone: ends all plays with the counts known.
    pub fn disconnect(&mut self, now: HostInstant, cause: EndCause, emit: &mut dyn Emit) {
        let stopped = self.session.as_ref().and_then(Session::e_stopped_at);
        let lost = self.tick_at(stopped.unwrap_or(now));
        let Some(session) = self.session.take() else { return };
        self.disconnect_reason = Some(cause.clone());
        self.plays.cut(&cause);
        self.live.forget(emit);
        let counters = self.known.status.map(|(status, tick)| {
            let lost = lost.unwrap_or(tick);
            let (bursts, pulses) = self.control.played_since_counters(tick, lost, stopped.is_some());
            let counters = status.counters;
            Counters { played: counters.played + bursts, pulses: counters.pulses + pulses, ..counters }
        });
        let lost = lost.or(self.known.status.map(|(_, tick)| tick)).unwrap_or_default();
        // The device may have played all that it had, or lost its power at any moment of it.
        let highest = self.control.highest(Tick(u64::MAX));
        self.control.reckon_to(lost);
        self.plays.close_all(counters, Some((&session, lost)), &self.control, emit);
        self.known.closed();
        self.control.cut(lost, None);
        self.control.bound_standing(&highest);
        self.standing_since =
            (self.control.highest_standing() > 0).then(|| self.standing_since.unwrap_or(now));
        self.feed = Feed::default();
        if self.latch.is_closed() {
            // Who waits for an emergency stop must see that it is latched when they get the answer.
            emit.event(StreamEvent::Snapshot(self.snapshot(now)));
        }
        self.operations.disconnected(emit);
        self.homing.disconnected(emit);
        self.operations.close(now, true, emit);
        self.reports.hasten(now);
    }

    /// Whether the shutdown is complete.
    pub const fn is_closed(&self) -> bool {
        self.operations.is_closed()
    }

    /// Takes the reason of the last disconnect.
    pub fn take_disconnect_reason(&mut self) -> Option<EndCause> {
        self.disconnect_reason.take()
    }

    /// The device's tick at `now`.
    pub fn tick_at(&self, now: HostInstant) -> Option<Tick> {
        self.session.as_ref().and_then(|session| session.clock().tick_at(now))
    }

    /// Whether a device has answered the handshake and reported its status.
    fn is_connected(&self) -> bool {
        self.known.status.is_some() && self.session.as_ref().is_some_and(Session::can_command)
    }

    pub(super) fn state(&self) -> State {
        match self.known.status {
            _ if self.latch.is_closed() => State::Faulted,
            Some((status, _)) => status.state,
            None => State::Disarmed,
        }
    }

    /// Does everything due at `now`. Call it after [`Self::receive`] and [`Self::execute`], before [`Self::transmit`].
    pub fn step(&mut self, now: HostInstant, emit: &mut dyn Emit) {
        if let Some(session) = &mut self.session {
            let events = &mut self.events;
            session.check_silence(now, &mut |event| events.push_back(event));
        }
        let is_idle = self.state() == State::Disarmed && self.plays.is_empty() && self.operations.is_empty();
        if let Some(session) = self.session.as_mut().filter(|session| is_idle && session.wants_probe(now)) {
            session.probe(Budget::default());
        }
        self.handle_link_events(now, emit);
        self.operations.send_next(self.session.as_mut(), &mut self.control);
        if self.operations.expire(now, self.session.as_mut(), emit) {
            self.plays.cut(&EndCause::NotArmed);
        }
        if self.homing.is_resetting()
            && self.operations.is_empty()
            && let Some((status, _)) = self.known.status
            && let Some(op) = self.homing.step_reset(&status, self.arm_op(false, false), emit)
        {
            self.order(now, 0, op, emit);
        }
        if let Some(tick) = self.tick_at(now) {
            if self.state() == State::Armed
                && self.operations.is_empty()
                && let Some(op) = self.homing.step(tick, &self.control, emit)
            {
                self.order(now, 0, op, emit);
            }
            self.with_connected(now, tick, |on, live, feed, _| {
                live.step(on, feed, emit);
                feed.feed(on, live.undecided(), emit);
            });
            self.correct(tick);
            self.end_drifted(now, tick, emit);
            let known = self.session.as_ref().map(|session| (session.known_to(), session.clock().estimate()));
            if let Some((known_to, Some(clock))) = known {
                self.plays.iter_mut().for_each(|active| active.note_ends(known_to, &clock));
            }
            self.with_connected(now, tick, |on, _, _, events| on.finish(events, emit));
        } else if self.session.is_none() {
            self.plays.close_all(None, None, &self.control, emit);
        }
        self.operations.close(now, self.is_off(), emit);
        let connected = self.is_connected();
        let line = self.session.as_ref().and_then(Session::capacity);
        // Also until a snapshot has shown that the pins are still.
        let moved = self.tick_at(now).is_some_and(|tick| self.control.moved_lately(tick));
        let moves = moved || self.homing.is_moving() || self.state() == State::Returning;
        let playing = moves || !self.plays.is_empty();
        let every = if playing { SNAPSHOT_EVERY } else { IDLE_PING };
        let known = connected && self.known.status.is_some_and(|(status, _)| status.position_known);
        let tick = self.tick_at(now).filter(|_| known);
        if let Some(heights) = emit.heights().filter(|heights| heights.is_due(now, tick.is_some())) {
            let stands = |(status, _): (Status, Tick)| {
                matches!(status.state, State::Disarmed | State::Faulted) && status.outstanding > 0
            };
            self.control.write_heights(heights, now, tick, self.known.status.is_some_and(stands));
        }
        if self.reports.take_due(now, connected, line, every) {
            let tick = self.tick_at(now).unwrap_or_default();
            self.reports.warn(&self.control, tick, self.settings.drift_warning_um, emit);
            emit.event(StreamEvent::Snapshot(self.snapshot(now)));
        }
    }

    /// Calls `act` with the parts of the streamer, if a device is connected.
    fn with_connected(
        &mut self,
        now: HostInstant,
        tick: Tick,
        act: impl FnOnce(&mut Connected<'_>, &mut Live, &mut Feed, &mut VecDeque<Event>),
    ) {
        let state = self.state();
        let Self { settings, session: Some(session), known, operations, plays, control, .. } = self else {
            return;
        };
        let mut on = Connected { now, tick, state, settings, known, session, operations, plays, control };
        act(&mut on, &mut self.live, &mut self.feed, &mut self.events);
    }

    /// Whether the device is off and nothing is under way, or there is none.
    fn is_off(&self) -> bool {
        match (&self.session, self.known.status) {
            (Some(session), Some((status, _))) => {
                let quiet = matches!(status.state, State::Disarmed | State::Faulted);
                quiet && session.is_answered() && self.operations.is_empty() && self.plays.is_empty()
            }
            _ => true,
        }
    }

    fn correct(&mut self, tick: Tick) {
        let idle = self.operations.is_in_flight() || self.state() != State::Armed;
        // After the last e-stop to a device that is not trusted, nothing counts as played.
        let Some(session) = self.session.as_mut().filter(|session| !idle && session.can_command()) else {
            return;
        };
        // Plays are fed in order: unsent strokes belong to the last play being fed, or come after it.
        let fed = self.plays.iter().rev().find(|active| !active.is_cut() && active.phase() != Phase::Waiting);
        let free = |motor| fed.map_or(tick, |active| active.free_until(motor));
        self.control.correct(tick, free, |item| session.amend(item));
    }

    /// Ends all plays if one that runs drives a pin that may be too far from rest. The motors stay armed.
    fn end_drifted(&mut self, now: HostInstant, tick: Tick, emit: &mut dyn Emit) {
        let limit_um = self.settings.drift_limit_um;
        let is_over = |active: &Active| {
            let runs = !active.is_cut() && active.onset().is_some_and(|onset| onset <= tick);
            runs && self.control.dead_reckoning_um(tick, active.play().strokes.motors()) > limit_um
        };
        if self.operations.is_empty() && self.plays.iter().any(is_over) {
            self.plays.cut(&EndCause::DriftLimit);
            self.order(now, 0, Op::Stop, emit);
        }
    }

    fn snapshot(&self, now: HostInstant) -> Snapshot {
        let open = self.session.as_ref().filter(|session| session.is_open());
        let tick = self.tick_at(now).unwrap_or_default();
        let status = self.known.status.map(|(status, _)| status);
        let running =
            self.plays.iter().rev().find(|active| {
                !active.is_cut() && active.started().is_some_and(|onset| onset.actual <= tick)
            });
        let played = |active: &Active| {
            let since = active.onset().map_or(0, |onset| tick - onset);
            (active.play().id, self.rate().ticks_to_seconds(since))
        };
        let lead = self.rate().ticks_to_ms(self.feed.until() - tick);
        Snapshot {
            at: now,
            connected: self.is_connected(),
            state: self.state(),
            cause: if self.latch.is_closed() {
                Cause::EStop
            } else {
                status.map_or(Cause::Boot, |status| status.cause)
            },
            position_known: status.is_some_and(|status| status.position_known),
            tick,
            clock: open.and_then(|session| session.clock().estimate()),
            play: running.map(played),
            lead_ms: if self.feed.is_short_of_credits() && running.is_some() {
                lead
            } else {
                self.settings.lead_ms
            },
            settings: self.settings,
            pins: Pins {
                rest: self.control.rest_error_um(tick),
                sensor_faults: self.control.faults(),
                movements: self
                    .control
                    .movements(tick, status.map_or(State::Disarmed, |status| status.state)),
                standing: self.standing_since.map(|since| (self.control.highest_standing(), since)),
                seen: self.control.sees_all(),
            },
            line_bytes_per_s: self.session.as_ref().and_then(Session::capacity),
            traffic: self.session.as_ref().map(Session::traffic).unwrap_or_default(),
            board: self.known.board,
            device_bad_frames: status.map_or(0, |status| status.counters.bad_frames),
        }
    }

    /// Writes the next due frame into `out` and returns its length; 0 if none is due.
    pub fn transmit(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME], emit: &mut dyn Emit) -> usize {
        let Some(session) = &mut self.session else { return 0 };
        let events = &mut self.events;
        let len = session.transmit(now, out, &mut |event| events.push_back(event));
        self.handle_link_events(now, emit);
        len
    }

    /// The epoch of an e-stop that has become due, once. Pass it to [`crate::device::Device::e_stop`]; the frame follows.
    #[must_use]
    pub fn take_e_stop(&mut self) -> Option<u16> {
        self.session.as_mut()?.take_e_stop()
    }

    /// When to call [`Self::step`] next, if nothing happens before.
    pub fn wake_at(&self, now: HostInstant) -> HostInstant {
        let quiet = self.plays.is_empty()
            && self.operations.is_empty()
            && !self.homing.is_moving()
            && !self.homing.is_resetting()
            && !self.operations.is_closing()
            && self.state() != State::Returning;
        let session = self.session.as_ref();
        let next = self.reports.wake_at(now, session.map(|session| session.wake_at(now)));
        if session.is_none_or(|session| quiet && session.is_open()) {
            next
        } else {
            next.min(now + BUSY_EVERY)
        }
    }
}

/// The controller's cause as events, receipts and the API name it.
pub const fn end_cause(cause: Cause) -> EndCause {
    match cause {
        Cause::Boot => EndCause::Boot,
        Cause::Request => EndCause::Request,
        Cause::Stop => EndCause::Stop,
        Cause::Shutdown => EndCause::Shutdown,
        Cause::Abort => EndCause::Abort,
        Cause::EStop => EndCause::EStop,
        Cause::HostTimeout => EndCause::HostTimeout,
        Cause::LinkLost => EndCause::LinkLost,
        Cause::NewHost => EndCause::NewHost,
        Cause::Starved => EndCause::Starved,
        Cause::Panic => EndCause::Panic,
        Cause::Watchdog => EndCause::Watchdog,
        Cause::Output => EndCause::Output,
    }
}
