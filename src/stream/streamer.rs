//! The deciding part of the streamer: orders, controls, what the device says, and the ends of plays.
//!
//! Feeding strokes ahead is in `feed`. Invariant: each play that was taken ends with exactly one
//! [`Notice::Ended`], and each order that asks for an answer gets exactly one.

use crate::link::{Event, LineRate, LostReason, Session, Verdict};
use crate::stream::Settings;
use crate::stream::active::{Active, FIRST_MARGIN, Phase};
use crate::stream::hold::Hold;
use crate::stream::port::{
    At, End, Job, LateCause, LatePolicy, Notice, Onset, Order, Play, QUEUE, Refused, Snapshot,
};
use crate::units::HostInstant;
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::{Cause, Counters, Op, State, Status};
use firmware_protocol::stroke::{MOTORS, Stroke};
use firmware_protocol::tick::{TICK_HZ, Tick};
use std::collections::VecDeque;
use std::time::Duration;

/// Controls that wait for the one before them, at the most.
const CONTROLS: usize = 8;
/// How long an answer may take.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);
/// While something is going on the streamer looks this often.
const BUSY_EVERY: Duration = Duration::from_millis(1);
const SNAPSHOT_EVERY: Duration = Duration::from_millis(100);
/// Keep-alives when nothing is armed.
const IDLE_PING: Duration = Duration::from_secs(1);

/// Says what happened.
pub(super) type Tell<'a> = &'a mut dyn FnMut(Notice);

/// What an order came to: refused or done at once, or waiting for the device.
type Taken = Result<Option<Op>, Refused>;

pub(super) fn ticks(duration: Duration) -> u64 {
    (duration.as_nanos() * u128::from(TICK_HZ) / 1_000_000_000) as u64
}

fn ticks_of_ms(ms: f64) -> u64 {
    (ms * f64::from(TICK_HZ) / 1000.0).round() as u64
}

#[derive(Clone, Copy, Debug)]
struct Waiting {
    ticket: u64,
    op: Op,
    since: HostInstant,
}

/// The streamer of one device.
#[derive(Debug)]
pub struct Streamer {
    pub(super) settings: Settings,
    pub(super) session: Option<Session>,
    events: VecDeque<Event>,
    /// The device's last word and the tick of it.
    status: Option<(Status, Tick)>,
    /// An e-stop was ordered and not reset: also kept for a device that comes later.
    latched: bool,
    /// Controls to send, the first is being sent.
    controls: VecDeque<Waiting>,
    in_flight: bool,
    pub(super) plays: VecDeque<Active>,
    pub(super) hold: Hold,
    /// Up to where the device is fed.
    pub(super) fed: Tick,
    /// The last stroke had to wait for credits.
    pub(super) short_of_credits: bool,
    closing: Option<(u64, HostInstant)>,
    closed: bool,
    snapshot_due: HostInstant,
}

impl Streamer {
    /// A streamer without a device.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            session: None,
            events: VecDeque::with_capacity(4096),
            status: None,
            latched: false,
            controls: VecDeque::with_capacity(CONTROLS),
            in_flight: false,
            plays: VecDeque::with_capacity(2 * QUEUE + 2),
            hold: Hold::new(),
            fed: Tick(0),
            short_of_credits: false,
            closing: None,
            closed: false,
            snapshot_due: HostInstant::default(),
        }
    }

    /// A device was opened; `id` is a random number.
    pub fn connect(&mut self, now: HostInstant, id: u32, rate: LineRate, tell: Tell<'_>) {
        self.disconnect(now, "another device was opened", tell);
        self.session = Some(Session::new(id, rate, now));
    }

    /// The device is gone: plays end, with what is known of them.
    pub fn disconnect(&mut self, now: HostInstant, cause: &'static str, tell: Tell<'_>) {
        let Some(session) = self.session.take() else { return };
        self.cut_all(End::Stopped, cause);
        let counters = self.status.map(|(status, tick)| {
            let lost = session.clock().tick_at(now).unwrap_or(tick);
            let (bursts, pulses) = self.hold.played_unheard(tick, lost);
            let counters = status.counters;
            Counters { played: counters.played + bursts, pulses: counters.pulses + pulses, ..counters }
        });
        let wire = session.traffic().bytes_out;
        let (rest_um, _) = self.hold.rest_error_um(self.status.map_or(Tick(0), |(_, tick)| tick));
        self.close_all(counters, wire, rest_um, tell);
        while let Some(waiting) = self.controls.pop_front() {
            answer(waiting.ticket, Err(Refused::NoDevice), tell);
        }
        self.in_flight = false;
        self.status = None;
        self.hold.reset(Tick(0));
        if let Some((ticket, _)) = self.closing.take() {
            self.closed = true;
            answer(ticket, Ok(()), tell);
        }
        self.snapshot_due = now;
    }

    /// Whether the order to shut down has been carried out.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Whether a session is wanted: `false` when there is none or it is over.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.session.is_some()
    }

    /// The device's tick at `now`.
    #[must_use]
    pub fn tick_at(&self, now: HostInstant) -> Option<Tick> {
        self.session.as_ref().and_then(|session| session.clock().tick_at(now))
    }

    pub(super) fn state(&self) -> State {
        match &self.status {
            _ if self.latched => State::Faulted,
            Some((status, _)) => status.state,
            None => State::Disarmed,
        }
    }

    /// Takes an order. [`Job::Connect`] is not for here: the thread opens the session.
    pub fn order(&mut self, now: HostInstant, order: Order, tell: Tell<'_>) {
        let ticket = order.ticket;
        let taken = match order.job {
            Job::Connect(_) => Ok(None),
            Job::Play(play) => match self.play(now, play) {
                Ok(()) => Ok(None),
                Err((refused, play)) => {
                    // It goes back as it came: memory is not given up here.
                    let (id, outcome) = Active::new(play, now, None).close(None, 0, [0.0; MOTORS]);
                    answer(ticket, Err(refused), tell);
                    tell(Notice::Ended { id, outcome });
                    return;
                }
            },
            Job::Stop => self.stop(),
            Job::EStop => self.emergency_stop(now, tell),
            Job::Reset => self.reset(),
            Job::Arm { assume_rest } => self.arm(assume_rest),
            Job::Disarm => self.disarm(),
            Job::Shutdown => {
                self.closing = Some((ticket, now));
                self.cut_all(End::Stopped, "shutdown");
                if self.session.is_some() {
                    self.control(now, 0, Op::Disarm(Cause::Shutdown), tell);
                }
                return;
            }
        };
        match taken {
            Ok(Some(op)) => self.control(now, ticket, op, tell),
            Ok(None) => answer(ticket, Ok(()), tell),
            Err(refused) => answer(ticket, Err(refused), tell),
        }
        self.snapshot_due = now;
    }

    fn ready(&self) -> Result<(), Refused> {
        if self.latched {
            return Err(Refused::Faulted);
        }
        let session = self.session.as_ref().filter(|session| session.is_open());
        let (Some(_), Some((status, _))) = (session, &self.status) else { return Err(Refused::NoDevice) };
        match status.state {
            State::Faulted => Err(Refused::Faulted),
            _ => Ok(()),
        }
    }

    /// Whether the device takes strokes, or will when what it returns now is back.
    fn takes_plays(&self) -> Result<(), Refused> {
        self.ready()?;
        let ordered = self.controls.iter().rev().find_map(|waiting| match waiting.op {
            Op::Arm { .. } => Some(true),
            Op::Disarm(_) => Some(false),
            _ => None,
        });
        let state = self.state();
        let returns_armed = state == State::Returning
            && matches!(self.status, Some((Status { cause: Cause::Stop | Cause::Request, .. }, _)));
        match ordered {
            Some(true) => Ok(()),
            None if state == State::Armed || returns_armed => Ok(()),
            _ if state == State::Returning => Err(Refused::Returning),
            _ => Err(Refused::Disarmed),
        }
    }

    fn play(&mut self, now: HostInstant, play: Box<Play>) -> Result<(), (Refused, Box<Play>)> {
        match self.place(now, &play) {
            Err(refused) => Err((refused, play)),
            Ok(requested) => {
                if play.replace && self.plays.iter().any(|active| active.cut.is_none()) {
                    self.cut_all(End::Stopped, "replaced");
                    self.controls.push_back(Waiting { ticket: 0, op: Op::Stop, since: now });
                }
                self.plays.push_back(Active::new(play, now, requested));
                Ok(())
            }
        }
    }

    /// Whether a play can be queued, and the onset it asks for.
    fn place(&self, now: HostInstant, play: &Play) -> Result<Option<Tick>, Refused> {
        self.takes_plays()?;
        let (Some(session), Some(tick)) = (&self.session, self.tick_at(now)) else {
            return Err(Refused::NoDevice);
        };
        let queued = || self.plays.iter().filter(|active| active.cut.is_none() && !play.replace);
        let held = self.plays.len() >= 2 * QUEUE + 1 || self.controls.len() == CONTROLS;
        if queued().count() > QUEUE || held {
            return Err(Refused::QueueFull);
        }
        let last = queued().next_back();
        if last.is_some_and(|last| last.play.strokes.end().is_none()) {
            return Err(Refused::BehindEndless);
        }
        let requested = match play.at {
            At::Next => return Ok(None),
            At::Tick(tick) => tick,
            At::After(ns) => session
                .clock()
                .tick_at(now + Duration::from_nanos(ns))
                .map(|at| at.max(tick + ticks(FIRST_MARGIN)))
                .ok_or(Refused::NoDevice)?,
        };
        if requested < tick + ticks(FIRST_MARGIN) || requested.since(tick) > 1 << 30 {
            return Err(Refused::TooSoon);
        }
        // A play that has no onset yet follows the one before it: its end is not known better than this.
        let free = queued().fold(tick, |free, active| {
            active.end().unwrap_or(free + ticks(FIRST_MARGIN) + active.play.strokes.end().unwrap_or(0))
        });
        if requested < free {
            return Err(Refused::Overlaps);
        }
        Ok(Some(requested))
    }

    fn stop(&mut self) -> Taken {
        self.ready()?;
        self.cut_all(End::Stopped, "stop");
        Ok(Some(Op::Stop))
    }

    fn disarm(&mut self) -> Taken {
        self.ready()?;
        self.cut_all(End::Stopped, "disarm");
        Ok(Some(Op::Disarm(Cause::Request)))
    }

    fn arm(&mut self, assume_rest: bool) -> Taken {
        self.ready()?;
        // A command begins a new epoch: it must not get between a play and its strokes for nothing.
        match self.state() {
            State::Armed => return Ok(None),
            State::Returning => return Err(Refused::Returning),
            State::Disarmed | State::Faulted => {}
        }
        if assume_rest {
            self.hold.forget_drift();
        }
        let lease = ticks_of_ms(self.settings.lease_ms) as u32;
        Ok(Some(Op::Arm { assume_rest, lease, limits: self.settings.limits }))
    }

    fn emergency_stop(&mut self, now: HostInstant, tell: Tell<'_>) -> Taken {
        self.latched = true;
        self.cut_all(End::Stopped, "estop");
        // It overtakes whatever waits.
        while let Some(waiting) = self.controls.pop_front() {
            answer(waiting.ticket, Err(Refused::Faulted), tell);
        }
        self.in_flight = false;
        self.snapshot_due = now;
        Ok(self.session.is_some().then_some(Op::EStop))
    }

    fn reset(&mut self) -> Taken {
        let faulted = self.state() == State::Faulted;
        self.latched = false;
        let open = self.session.as_ref().is_some_and(Session::is_open);
        Ok((open && faulted).then_some(Op::Reset))
    }

    fn control(&mut self, now: HostInstant, ticket: u64, op: Op, tell: Tell<'_>) {
        if self.controls.len() == CONTROLS {
            answer(ticket, Err(Refused::Timeout), tell);
            return;
        }
        self.controls.push_back(Waiting { ticket, op, since: now });
        self.next_control();
    }

    /// Ends everything because of a play: return, disarm.
    pub(super) fn abort(&mut self, now: HostInstant, tell: Tell<'_>) {
        self.control(now, 0, Op::Disarm(Cause::Abort), tell);
    }

    /// Whether no command is on its way.
    pub(super) fn may_feed(&self) -> bool {
        self.controls.is_empty()
    }

    fn next_control(&mut self) {
        let Some(session) = self.session.as_mut().filter(|session| session.is_open()) else { return };
        if let (false, Some(first)) = (self.in_flight, self.controls.front()) {
            self.in_flight = true;
            session.command(first.op);
        }
    }

    /// All plays end here, for this reason, unless they have another already.
    fn cut_all(&mut self, end: End, cause: &'static str) {
        for active in &mut self.plays {
            active.cut = active.cut.or(Some((end, cause)));
        }
    }

    fn close_all(&mut self, after: Option<Counters>, wire: u64, rest_um: [f32; MOTORS], tell: Tell<'_>) {
        while let Some(active) = self.plays.pop_front() {
            let until = self.plays.front().and_then(|next| next.begun).or(after);
            let (id, outcome) = active.close(until, wire, rest_um);
            tell(Notice::Ended { id, outcome });
        }
    }

    /// Takes bytes from the device.
    pub fn receive(&mut self, now: HostInstant, bytes: &[u8], tell: Tell<'_>) {
        let Some(session) = &mut self.session else { return };
        let events = &mut self.events;
        session.receive(now, bytes, &mut |event| events.push_back(event));
        self.drain(now, tell);
    }

    fn drain(&mut self, now: HostInstant, tell: Tell<'_>) {
        while let Some(event) = self.events.pop_front() {
            self.event(now, event, tell);
        }
    }

    fn event(&mut self, now: HostInstant, event: Event, tell: Tell<'_>) {
        match event {
            Event::Opened(hello) => {
                tell(Notice::Connected(hello));
                if self.latched {
                    self.control(now, 0, Op::EStop, tell);
                }
            }
            Event::Lost(reason) => {
                let reason = lost_text(reason);
                self.disconnect(now, reason, tell);
                tell(Notice::Disconnected { reason, device: None });
            }
            Event::Control(result) => {
                self.in_flight = false;
                if let Some(done) = self.controls.pop_front() {
                    if result.is_err() {
                        self.cut_all(End::Stopped, "the device refused the command before it");
                    }
                    answer(done.ticket, result.map_err(Refused::Device), tell);
                }
                self.snapshot_due = now;
            }
            Event::Status { status, tick } => self.status(now, status, tick),
            Event::Stroke(stroke, verdict) => self.verdict(now, &stroke, verdict, tell),
            Event::OnsetRefused { rendered } => self.onset_refused(now, rendered),
            Event::OnsetTaken => {
                if let Some(active) = self.plays.iter_mut().find(|active| active.phase == Phase::Offered) {
                    active.phase = Phase::Streaming;
                }
            }
            Event::Onset { tick, counters } => self.onset(tick, counters, tell),
            Event::Cut { cut, .. } => {
                if !matches!(cut.cause, Cause::Stop | Cause::Request) {
                    self.cut_all(End::Stopped, cause_text(cut.cause));
                }
                self.snapshot_due = now;
            }
            Event::StrokeRefused { motor, up, reason } => {
                self.hold.refused(motor, up);
                if let Some(active) = self.owner(up) {
                    active.refused();
                    let id = active.play.id;
                    tell(Notice::StrokeRefused { id, motor, up, reason });
                }
            }
            Event::Telemetry { tick, y } => self.hold.telemetry(tick, &y),
        }
    }

    fn status(&mut self, now: HostInstant, status: Status, tick: Tick) {
        let before = self.status.replace((status, tick)).map(|(status, _)| status);
        self.hold.heard();
        let changed = before.is_none_or(|before| {
            (before.state, before.cause, before.position_known, before.owed)
                != (status.state, status.cause, status.position_known, status.owed)
        });
        if !changed {
            return;
        }
        self.snapshot_due = now;
        let armed = matches!(status.state, State::Armed | State::Returning);
        let lease = Duration::from_secs_f64(self.settings.lease_ms / 1000.0);
        if let Some(session) = &mut self.session {
            session.ping_every(if armed { lease / 5 } else { IDLE_PING }, now);
        }
        if !armed && self.controls.is_empty() {
            self.cut_all(End::Stopped, cause_text(status.cause));
        }
        if status.state == State::Armed && before.is_none_or(|before| before.state != State::Armed) {
            // All pins have come to rest by the device's own count.
            self.hold.reset(tick);
        }
    }

    /// The play that a stroke which goes up at `up` belongs to.
    fn owner(&mut self, up: Tick) -> Option<&mut Active> {
        self.plays
            .iter_mut()
            .rev()
            .find(|active| active.phase != Phase::Waiting && active.onset.is_some_and(|onset| onset <= up))
    }

    fn verdict(&mut self, now: HostInstant, stroke: &Stroke, verdict: Verdict, tell: Tell<'_>) {
        let earliest = ticks(FIRST_MARGIN);
        let sent_tick = |sent| self.tick_at(sent).unwrap_or_default();
        let cause = match verdict {
            Verdict::Late { again: true, .. } => LateCause::Link,
            Verdict::Late { sent, .. } if sent_tick(sent) + earliest > stroke.up => LateCause::Host,
            _ => LateCause::Link,
        };
        let Some(active) = self.owner(stroke.up) else { return };
        active.undecided = active.undecided.saturating_sub(1);
        let (id, steered) = (active.play.id, !active.play.open_loop);
        let (motor, up) = (stroke.motor, stroke.up);
        match verdict {
            Verdict::Accepted => self.hold.accepted(stroke, steered),
            Verdict::Refused(reason) => {
                active.refused();
                tell(Notice::StrokeRefused { id, motor, up, reason });
            }
            Verdict::Late { rendered, .. } => self.late(now, stroke, rendered, cause, tell),
        }
    }

    /// A stroke could not be played any more when `free` was the first tick that could.
    pub(super) fn late(
        &mut self,
        now: HostInstant,
        stroke: &Stroke,
        free: Tick,
        cause: LateCause,
        tell: Tell<'_>,
    ) {
        let late_ms = (free - stroke.up) as f64 / f64::from(TICK_HZ) * 1000.0;
        let Some(active) = self.owner(stroke.up) else { return };
        active.late(late_ms, cause);
        let (id, policy, cut) = (active.play.id, active.play.late, active.cut.is_some());
        tell(Notice::Late { id, motor: stroke.motor, up: stroke.up, late_ms, cause });
        if policy == LatePolicy::Abort && !cut {
            self.cut_all(End::Aborted, "late strokes");
            self.abort(now, tell);
        }
    }

    fn onset_refused(&mut self, now: HostInstant, rendered: Tick) {
        let longest = Duration::from_secs_f64(self.settings.lead_ms / 1000.0).max(FIRST_MARGIN * 32);
        let Some(active) = self.plays.iter_mut().find(|active| active.phase == Phase::Offered) else {
            return;
        };
        active.phase = Phase::Waiting;
        active.undecided = 0;
        active.onset = None;
        active.margin *= 2;
        if active.is_fixed() || active.margin > longest {
            active.late_as_a_whole();
            active.cut = active.cut.or(Some((End::Aborted, "the onset could not be kept")));
        }
        self.fed = rendered;
        self.snapshot_due = now;
    }

    fn onset(&mut self, tick: Tick, counters: Counters, tell: Tell<'_>) {
        let Some(session) = &self.session else { return };
        let clock = session.clock();
        let Some(active) = self.plays.iter_mut().find(|active| active.onset == Some(tick)) else { return };
        let at = clock.instant_of(tick).unwrap_or_default();
        let onset = Onset {
            requested: active.requested.unwrap_or(tick),
            actual: tick,
            at,
            uncertainty_ns: clock.uncertainty(at).unwrap_or_default().as_nanos() as u64,
            latency_ns: at.since(active.ordered).as_nanos() as u64,
        };
        active.began(onset, counters);
        tell(Notice::Began { id: active.play.id, onset });
    }

    /// Does what is due at `now`. Call it after [`Self::receive`] and [`Self::order`], before [`Self::transmit`].
    pub fn step(&mut self, now: HostInstant, tell: Tell<'_>) {
        self.next_control();
        self.expire(now, tell);
        if let Some(tick) = self.tick_at(now) {
            self.feed(now, tick, tell);
            self.correct(tick);
            self.finish(tick, tell);
        } else if self.session.is_none() {
            self.close_all(None, 0, [0.0; MOTORS], tell);
        }
        self.close(now, tell);
        if now >= self.snapshot_due {
            let playing = !self.plays.is_empty() || self.state() == State::Returning;
            let far = if playing { SNAPSHOT_EVERY } else { IDLE_PING };
            self.snapshot_due = now + far;
            tell(Notice::Snapshot(self.snapshot(now)));
        }
    }

    fn correct(&mut self, tick: Tick) {
        let idle = self.in_flight || self.state() != State::Armed;
        let Some(session) = self.session.as_mut().filter(|_| !idle) else { return };
        self.hold.correct(tick, |item| session.amend(item));
    }

    /// Tells who asked that no answer came in time; the control itself is repeated until it is answered.
    fn expire(&mut self, now: HostInstant, tell: Tell<'_>) {
        for waiting in &mut self.controls {
            if now.since(waiting.since) >= ANSWER_WITHIN {
                answer(std::mem::take(&mut waiting.ticket), Err(Refused::Timeout), tell);
            }
        }
    }

    /// Ends the plays that are over, first to last.
    fn finish(&mut self, tick: Tick, tell: Tell<'_>) {
        let returning = self.state() == State::Returning;
        let Some(session) = &mut self.session else { return };
        while let Some(first) = self.plays.front() {
            let next = self.plays.get(1);
            let next_begun = next.and_then(|next| next.begun);
            let Some((status, at)) = &self.status else { return };
            let after = if first.cut.is_some() {
                let settled = !self.in_flight
                    && self.controls.is_empty()
                    && session.is_settled()
                    && status.state != State::Returning;
                (settled || first.phase == Phase::Waiting).then_some(status.counters)
            } else {
                let end = first.end().map_or(first.last_end, |end| end.max(first.last_end));
                let decided = first.phase == Phase::Streamed && first.undecided == 0;
                // Counters that hold all of this play and nothing of the next.
                let next_onset = next.and_then(|next| next.onset).unwrap_or(Tick(u64::MAX));
                let now_known =
                    (*at >= end && *at < next_onset && first.begun.is_some()).then_some(status.counters);
                next_begun.or(now_known).filter(|_| decided && tick >= end)
            };
            let Some(after) = after else { break };
            let wire = session.traffic().bytes_out;
            let (rest_um, _) = self.hold.rest_error_um(tick);
            let Some(active) = self.plays.pop_front() else { break };
            let (id, outcome) = active.close(Some(next_begun.unwrap_or(after)), wire, rest_um);
            tell(Notice::Ended { id, outcome });
        }
        let over = self.plays.front().is_some_and(|first| {
            first.cut.is_some()
                || (first.phase == Phase::Streamed && first.end().is_some_and(|end| tick >= end))
        });
        if over || returning || self.closing.is_some() {
            session.ask();
        }
    }

    /// Ends the thread once the device is off, or does not say so in time.
    fn close(&mut self, now: HostInstant, tell: Tell<'_>) {
        let Some((ticket, since)) = self.closing else { return };
        let off = match (&self.session, &self.status) {
            (Some(session), Some((status, _))) => {
                let quiet = matches!(status.state, State::Disarmed | State::Faulted);
                quiet && session.is_settled() && self.controls.is_empty() && self.plays.is_empty()
            }
            _ => true,
        };
        if off || now.since(since) >= ANSWER_WITHIN {
            self.closing = None;
            self.closed = true;
            answer(ticket, if off { Ok(()) } else { Err(Refused::Timeout) }, tell);
        }
    }

    fn snapshot(&self, now: HostInstant) -> Snapshot {
        let open = self.session.as_ref().filter(|session| session.is_open());
        let tick = self.tick_at(now).unwrap_or_default();
        let traffic = self.session.as_ref().map(Session::traffic).unwrap_or_default();
        let (rest_error_um, source) = self.hold.rest_error_um(tick);
        let status = self.status.map(|(status, _)| status);
        let running = self.plays.iter().rev().find(|active| {
            active.cut.is_none() && active.started().is_some_and(|onset| onset.actual <= tick)
        });
        let played = |active: &Active| {
            let since = active.onset.map_or(0, |onset| tick - onset);
            (active.play.id, since as f64 / f64::from(TICK_HZ))
        };
        let pool = firmware_protocol::controller::POOL as u32;
        let lead = (self.fed - tick) as f64 / f64::from(TICK_HZ) * 1000.0;
        Snapshot {
            at: now,
            connected: open.is_some(),
            state: self.state(),
            cause: if self.latched {
                Cause::EStop
            } else {
                status.map_or(Cause::Boot, |status| status.cause)
            },
            position_known: status.is_some_and(|status| status.position_known),
            owed: status.map_or(0, |status| status.owed),
            tick,
            clock_uncertainty_us: open
                .and_then(|session| session.clock().uncertainty(now))
                .map_or(f64::INFINITY, |uncertainty| uncertainty.as_nanos() as f64 / 1000.0),
            play: running.map(played),
            in_device: status.map_or(0, |status| pool.saturating_sub(status.credits.into())),
            lead_ms: if self.short_of_credits { lead } else { self.settings.lead_ms },
            rest_error_um,
            source,
            bytes_out: traffic.bytes_out,
            bytes_in: traffic.bytes_in,
            retransmitted: traffic.again,
        }
    }

    /// Writes the next frame that is due into `out` and returns its length; 0 when none is.
    pub fn transmit(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME], tell: Tell<'_>) -> usize {
        let Some(session) = &mut self.session else { return 0 };
        let events = &mut self.events;
        let len = session.transmit(now, out, &mut |event| events.push_back(event));
        self.drain(now, tell);
        len
    }

    /// When [`Self::step`] is due, if nothing happens before.
    #[must_use]
    pub fn wake_at(&self, now: HostInstant) -> HostInstant {
        let quiet = self.plays.is_empty()
            && self.controls.is_empty()
            && self.closing.is_none()
            && self.state() != State::Returning;
        let Some(session) = &self.session else { return now + Duration::from_secs(3600) };
        let next = session.wake_at(now).min(self.snapshot_due);
        if quiet && session.is_open() { next } else { next.min(now + BUSY_EVERY) }
    }
}

fn answer(ticket: u64, result: Result<(), Refused>, tell: Tell<'_>) {
    if ticket != 0 {
        tell(Notice::Answer { ticket, result });
    }
}

fn lost_text(reason: LostReason) -> &'static str {
    match reason {
        LostReason::NoAnswer => "the device does not answer",
        LostReason::Restarted => "the device has restarted",
        LostReason::Version => {
            "the device speaks another protocol version: update its firmware or this daemon"
        }
        LostReason::WrongArray => "the device's motors or tick rate are not this array's",
    }
}

/// A cause as events, receipts and the API name it.
#[must_use]
pub fn cause_text(cause: Cause) -> &'static str {
    match cause {
        Cause::Boot => "boot",
        Cause::Request => "request",
        Cause::Stop => "stop",
        Cause::Shutdown => "shutdown",
        Cause::Abort => "abort",
        Cause::EStop => "estop",
        Cause::Lease => "lease",
        Cause::LinkLost => "link-lost",
        Cause::NewHost => "new-host",
        Cause::Starved => "starved",
        Cause::Panic => "panic",
    }
}
