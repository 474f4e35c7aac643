//! CommandQueue: which can be taken now, and the commands they become, one at a time.

use crate::active::{Active, FIRST_MARGIN};
use crate::link::Session;
use crate::queues::{At, Command, CommandError, End, MAX_QUEUED_PLAYS, Play, Request, StreamEvent};
use crate::streamer::{ANSWER_WITHIN, CONTROLS, Streamer, Taken, Tell, Waiting, answer, cuts};
use crate::time::HostInstant;
use firmware_protocol::message::{Cause, Op, State};
use firmware_protocol::tick::Tick;
use meissner_array::units::{duration_to_ticks, ms_in_ticks};
use std::time::Duration;

/// How far ahead an onset may lie: half of what a stroke may, so that every wire tick is read as it was meant.
const FARTHEST: u64 = 1 << 29;

/// The part of the first margin that is not for the line: the horizon, and a wake-up.
const WAKE_UP: Duration = Duration::from_micros(1500);

impl Streamer {
    /// Takes an order. [`Command::Connect`] is not for here: the thread opens the session.
    pub fn execute(&mut self, now: HostInstant, request: Request, tell: Tell<'_>) {
        let Request { ticket, issued_at: given, .. } = request;
        // Whoever gave it has been told by now that nothing came of it.
        let stale = now.since(given) >= ANSWER_WITHIN;
        let taken = match request.command {
            Command::Connect(_) => Ok(None),
            Command::Play(play) if stale => {
                answer(ticket, Err(CommandError::Timeout), tell);
                tell(StreamEvent::PlayRejected(play));
                return;
            }
            Command::Arm { .. } | Command::Reset if stale => Err(CommandError::Timeout),
            Command::Play(play) => match self.play(now, given, play) {
                Ok(()) => Ok(None),
                Err((refused, play)) => {
                    answer(ticket, Err(refused), tell);
                    tell(StreamEvent::PlayRejected(play));
                    return;
                }
            },
            Command::Stop => self.stop(),
            Command::EStop => self.emergency_stop(now, tell),
            Command::Reset => self.reset(),
            Command::Arm { assume_rest } => self.arm(assume_rest),
            Command::Home => match self.home(ticket) {
                // It is answered when the pins are home.
                Ok(_) => return,
                Err(refused) => Err(refused),
            },
            Command::SetGains(gains) => {
                self.control.calibrate(&gains);
                tell(StreamEvent::GainsApplied(gains));
                Ok(None)
            }
            Command::Configure(settings) => {
                self.next_settings = settings;
                // What the device was armed with holds until it is armed again.
                if !self.wants_armed && !matches!(self.state(), State::Armed | State::Returning) {
                    self.settle();
                }
                Ok(None)
            }
            Command::Disarm => self.disarm(),
            Command::Shutdown => {
                self.closing = Some((ticket, now));
                self.wants_armed = false;
                self.cut_all(End::Stopped, "shutdown");
                self.end_homing(Err(CommandError::Returning), tell);
                if self.session.is_some() {
                    self.control(now, 0, Op::Disarm(Cause::Shutdown), tell);
                }
                return;
            }
        };
        match taken {
            Ok(Some(op)) => {
                self.end_homing(Err(CommandError::Returning), tell);
                self.control(given, ticket, op, tell);
            }
            Ok(None) => answer(ticket, Ok(()), tell),
            Err(refused) => answer(ticket, Err(refused), tell),
        }
        self.snapshot_due = now;
    }

    /// Whether commands can be given: they wait for a handshake that is under way.
    fn ready(&self) -> Result<(), CommandError> {
        match (&self.session, self.state()) {
            (None, _) if !self.latched => Err(CommandError::NoDevice),
            (_, State::Faulted) => Err(CommandError::Faulted),
            _ => Ok(()),
        }
    }

    /// Whether the device takes strokes, or will when the commands given are carried out.
    pub(super) fn takes_plays(&self) -> Result<(), CommandError> {
        self.ready()?;
        match self.state() {
            _ if self.wants_armed => Ok(()),
            State::Returning => Err(CommandError::Returning),
            _ => Err(CommandError::Disarmed),
        }
    }

    fn play(
        &mut self,
        now: HostInstant,
        given: HostInstant,
        play: Box<Play>,
    ) -> Result<(), (CommandError, Box<Play>)> {
        match self.place(now, &play) {
            Err(refused) => Err((refused, play)),
            Ok((requested, margin)) => {
                if play.replace && self.plays.iter().any(|active| active.cut.is_none()) {
                    self.cut_all(End::Stopped, "replaced");
                    self.controls.push_back(Waiting { ticket: 0, op: Op::Stop, since: now });
                }
                self.plays.push_back(Active::new(play, given, requested, margin));
                Ok(())
            }
        }
    }

    /// How far ahead of its onset a play has to be sent from, if the line carries it at all.
    pub(super) fn margin(&self, session: &Session, play: &Play) -> Result<Duration, CommandError> {
        let steered = !play.open_loop && self.control.steers(self.telemetry);
        let demand = if steered { play.bandwidth.closed } else { play.bandwidth.open };
        match session.rate_left(demand.frames) {
            Some(carries) if demand.rate > carries => {
                Err(CommandError::LineTooSlow { needs: demand.rate, carries })
            }
            Some(carries) => {
                // Before there is a lead, two slow answers in a row must not make what follows the first frame late.
                let waiting = 2 * session.ack_wait().unwrap_or_default();
                Ok(FIRST_MARGIN.max(WAKE_UP + waiting + demand.ahead(carries)))
            }
            None => Ok(FIRST_MARGIN),
        }
    }

    /// Whether a play can be queued, the onset it asks for, and how far ahead it has to be sent.
    fn place(&self, now: HostInstant, play: &Play) -> Result<(Option<Tick>, Duration), CommandError> {
        self.takes_plays()?;
        if self.homing.is_some() {
            return Err(CommandError::Returning);
        }
        let (Some(session), Some(tick)) = (&self.session, self.tick_at(now)) else {
            return Err(CommandError::NoDevice);
        };
        let queued = || self.plays.iter().filter(|active| active.cut.is_none() && !play.replace);
        let held = self.plays.len() > 2 * MAX_QUEUED_PLAYS || self.controls.len() == CONTROLS;
        if queued().count() > MAX_QUEUED_PLAYS || held {
            return Err(CommandError::QueueFull);
        }
        let last = queued().next_back();
        if last.is_some_and(|last| last.play.strokes.end().is_none()) {
            return Err(CommandError::BehindEndless);
        }
        let margin = self.margin(session, play)?;
        let requested = match play.at {
            At::Next => return Ok((None, margin)),
            At::Tick(tick) => tick,
            At::After(ns) => session
                .clock()
                .tick_at(now + Duration::from_nanos(ns))
                .map(|at| at.max(tick + duration_to_ticks(margin)))
                .ok_or(CommandError::NoDevice)?,
        };
        if requested < tick + duration_to_ticks(margin) {
            return Err(CommandError::TooSoon);
        }
        if requested - tick > FARTHEST {
            return Err(CommandError::TooFar);
        }
        // A play that has no onset yet follows the one before it: its end is not known better than this.
        let free = queued().fold(tick, |free, active| {
            active
                .end()
                .unwrap_or(free + duration_to_ticks(FIRST_MARGIN) + active.play.strokes.end().unwrap_or(0))
        });
        if requested < free {
            return Err(CommandError::Overlaps);
        }
        Ok((Some(requested), margin))
    }

    fn stop(&mut self) -> Taken {
        self.ready()?;
        if self.controls.len() == CONTROLS {
            return Err(CommandError::Returning);
        }
        self.cut_all(End::Stopped, "stop");
        Ok(Some(Op::Stop))
    }

    fn disarm(&mut self) -> Taken {
        self.ready()?;
        self.wants_armed = false;
        self.cut_all(End::Stopped, "disarm");
        Ok(Some(Op::Disarm(Cause::Request)))
    }

    fn arm(&mut self, assume_rest: bool) -> Taken {
        self.ready()?;
        // A command begins a new epoch: it must not get between a play and its strokes for nothing.
        match self.state() {
            State::Armed if self.wants_armed => return Ok(None),
            State::Armed | State::Returning if !self.wants_armed => return Err(CommandError::Returning),
            State::Returning => return Ok(None),
            _ if self.wants_armed => return Err(CommandError::Returning),
            _ => {}
        }
        self.wants_armed = true;
        self.settle();
        self.control.clear_faults();
        if assume_rest {
            self.control.assume_rest();
        }
        let host_timeout = ms_in_ticks(self.settings.lease_ms).round() as u32;
        Ok(Some(Op::Arm { assume_rest, host_timeout, limits: self.settings.limits }))
    }

    /// Goes by the settings that were ordered last.
    fn settle(&mut self) {
        self.settings = self.next_settings;
        self.control.limit(&self.settings.limits);
    }

    fn emergency_stop(&mut self, now: HostInstant, tell: Tell<'_>) -> Taken {
        self.latched = true;
        self.wants_armed = false;
        self.cut_all(End::Stopped, "estop");
        // It overtakes whatever waits.
        while let Some(waiting) = self.controls.pop_front() {
            answer(waiting.ticket, Err(CommandError::Faulted), tell);
        }
        self.in_flight = false;
        self.snapshot_due = now;
        Ok(self.session.is_some().then_some(Op::EStop))
    }

    fn reset(&mut self) -> Taken {
        let faulted = self.state() == State::Faulted;
        self.latched = false;
        let open = self.session.as_ref().is_some_and(Session::can_command);
        Ok((open && faulted).then_some(Op::Reset))
    }

    pub(super) fn control(&mut self, given: HostInstant, ticket: u64, op: Op, tell: Tell<'_>) {
        if matches!(op, Op::Disarm(_)) {
            // It makes whatever waits pointless, and must not wait behind it.
            while self.controls.len() > usize::from(self.in_flight) {
                let Some(waiting) = self.controls.pop_back() else { break };
                answer(waiting.ticket, Err(CommandError::Returning), tell);
            }
        }
        if self.controls.len() == CONTROLS {
            answer(ticket, Err(CommandError::Timeout), tell);
            return;
        }
        self.controls.push_back(Waiting { ticket, op, since: given });
        self.next_control();
    }

    /// Ends everything because of a play: return, disarm.
    pub(super) fn abort(&mut self, now: HostInstant, tell: Tell<'_>) {
        self.wants_armed = false;
        self.control(now, 0, Op::Disarm(Cause::Abort), tell);
    }

    /// Whether no command is on its way.
    pub(super) fn may_feed(&self) -> bool {
        self.controls.is_empty()
    }

    pub(super) fn next_control(&mut self) {
        let Some(session) = self.session.as_mut().filter(|session| session.can_command()) else { return };
        if let (false, Some(first)) = (self.in_flight, self.controls.front()) {
            // What the line carries is measured while nothing can move.
            if matches!(first.op, Op::Arm { .. }) && !session.is_probed() {
                return;
            }
            self.in_flight = true;
            if cuts(&first.op) {
                self.control.will_be_cut();
            }
            session.command(first.op);
        }
    }

    /// Tells who asked that no answer came in time. An arm or reset that waits is not sent any more, an arm that was
    /// sent is followed by a disarm: nobody expects them later. All else is sent until it is answered.
    pub(super) fn expire(&mut self, now: HostInstant, tell: Tell<'_>) {
        let mut index = usize::from(self.in_flight);
        while let Some(waiting) =
            self.controls.get_mut(index).filter(|it| now.since(it.since) >= ANSWER_WITHIN)
        {
            answer(std::mem::take(&mut waiting.ticket), Err(CommandError::Timeout), tell);
            let op = waiting.op;
            if !matches!(op, Op::Arm { .. } | Op::Reset) {
                index += 1;
                continue;
            }
            self.controls.remove(index);
            if matches!(op, Op::Arm { .. }) {
                self.wants_armed = false;
                self.cut_all(End::Stopped, "not armed in time");
            }
        }
        let (Some(first), Some(session)) = (self.controls.front_mut(), &mut self.session) else { return };
        if now.since(first.since) >= ANSWER_WITHIN {
            answer(std::mem::take(&mut first.ticket), Err(CommandError::Timeout), tell);
            if matches!(first.op, Op::Arm { .. }) {
                first.op = Op::Disarm(Cause::Request);
                self.wants_armed = false;
                session.command(first.op);
                self.cut_all(End::Stopped, "not armed in time");
            }
        }
    }
}
