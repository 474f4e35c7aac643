//! Executes commands: decides which are possible now, and sends their operations to the device one at a time.
//!
//! [`Streamer::execute`] takes each request; `operations` answers those that the device does not answer in time.

use crate::active::{Active, FIRST_MARGIN, Phase, edge_delay};
use crate::link::Session;
use crate::queues::{At, Command, CommandError, Emit, Item, MAX_QUEUED_PLAYS, Play, Request, StreamEvent};
use crate::streamer::feed::margin;
use crate::streamer::live::is_live;
use crate::streamer::operations::{ANSWER_WITHIN, answer};
use crate::streamer::{OpResult, Streamer};
use crate::time::HostInstant;
use firmware_protocol::message::{Cause, LowerStop, Op, State};
use firmware_protocol::tick::Tick;
use meissner_api::EndCause;
use std::time::Duration;

/// Farthest onset ahead, ticks: half of what a stroke may have, so that every wire tick is unambiguous.
const FARTHEST: u64 = 1 << 29;

/// Without a check, pins may be taken as at rest up to this estimate, root mean square, µm. Our choice: one stroke of 80 µm after
/// a rest leaves 20 µm, 16 µm by its transient and 11 µm by its scatter. After more play a person must look.
const LEVEL_CHECK_UM: f32 = 20.0;

/// How an `arm` knows that pins are at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rest {
    /// The device knows where they are.
    Known,
    /// A client says so, and nobody has looked.
    Unchecked,
    /// Somebody has looked.
    Checked,
}

/// How long the report of an edge takes to the streamer: a block, a frame of USB, a wake-up.
const EDGE_REPORTED: Duration = Duration::from_millis(2);

impl Streamer {
    /// Executes a request. [`Command::Connect`] does nothing here: the thread opens the session with [`Self::connect`].
    pub fn execute(&mut self, now: HostInstant, request: Request, emit: &mut dyn Emit) {
        let Request { ticket, issued_at: given, .. } = request;
        // The client has given up waiting by now.
        let stale = now.since(given) >= ANSWER_WITHIN;
        let taken = match request.command {
            Command::Connect(_) => Ok(None),
            // The thread has made it, or there is no simulated array.
            Command::Edge { .. } => Err(CommandError::NotSimulated),
            Command::WithdrawEdges(_) => Ok(None),
            Command::Play(play) if stale => {
                answer(ticket, Err(CommandError::Timeout), emit);
                emit.event(StreamEvent::PlayRejected(play));
                return;
            }
            Command::Arm { .. } | Command::ArmUnchecked | Command::Reset { .. } if stale => {
                Err(CommandError::Timeout)
            }
            Command::Play(play) => match self.play(now, given, play, emit) {
                Ok(()) => Ok(None),
                Err((refused, play)) => {
                    answer(ticket, Err(refused), emit);
                    emit.event(StreamEvent::PlayRejected(play));
                    return;
                }
            },
            Command::UpdateLive(update) => {
                let array = self.array();
                self.live.update(given, update, array, &self.plays, emit);
                return;
            }
            Command::EndLive(id) => self.end_live(id),
            // Nothing changes, so no report is due: the daemon answers each report with the same order.
            Command::Cancel { id, .. }
                if !self.plays.iter().any(|active| active.play().id == id && !active.is_cut()) =>
            {
                answer(ticket, Ok(()), emit);
                return;
            }
            Command::Cancel { id, cause } => self.cancel(id, cause),
            Command::Withdraw(id) => {
                let after = self.known.status.map(|(status, _)| status.counters);
                let at = self.known.status.map_or(Tick(0), |(_, at)| at);
                self.plays.withdraw(id, after, at, &self.control, emit).map(|()| None)
            }
            Command::Stop => self.stop(),
            Command::EStop => {
                self.emergency_stop(now, ticket, emit);
                return;
            }
            Command::Reset { estops_seen, keep: true } => self.reset(estops_seen),
            Command::Reset { estops_seen, keep: false } => match self.reset(estops_seen) {
                Ok(_) if self.operations.is_full() => Err(CommandError::Returning),
                Ok(op) if self.is_connected() => {
                    // The answer comes when the pins are back.
                    self.homing.begin_reset(ticket, emit);
                    if let Some(op) = op {
                        self.order(given, 0, op, emit);
                    }
                    self.reports.hasten(now);
                    return;
                }
                taken => taken,
            },
            Command::Arm { assume_rest: false } => self.arm(now, Rest::Known),
            Command::Arm { assume_rest: true } => self.arm(now, Rest::Checked),
            Command::ArmUnchecked => self.arm(now, Rest::Unchecked),
            Command::Home => match self.home(ticket) {
                // The answer comes when the pins are home.
                Ok(None) => return,
                taken => taken,
            },
            Command::SetGains(gains) => {
                self.control.set_gains(&gains);
                emit.event(StreamEvent::GainsApplied(gains));
                Ok(None)
            }
            Command::Disarm => self.disarm(),
            Command::Shutdown => {
                self.operations.shut_down(now, ticket);
                self.plays.cut(&EndCause::Shutdown);
                self.homing.end(Err(CommandError::Returning), emit);
                if self.session.is_some() {
                    self.order(now, 0, Op::Disarm(Cause::Shutdown), emit);
                }
                return;
            }
        };
        match taken {
            Ok(Some(op)) => {
                self.homing.end(Err(CommandError::Returning), emit);
                self.order(given, ticket, op, emit);
            }
            Ok(None) => answer(ticket, Ok(()), emit),
            Err(refused) => {
                answer(ticket, Err(refused), emit);
                // The daemon repeats its own orders at the next report.
                if ticket == 0 {
                    return;
                }
            }
        }
        self.reports.hasten(now);
    }

    /// Whether the device can take commands; they wait for a handshake under way.
    fn ready(&self) -> Result<(), CommandError> {
        match (&self.session, self.state()) {
            (None, _) if !self.latch.is_closed() => Err(CommandError::NoDevice),
            (_, State::Faulted) => Err(CommandError::Faulted),
            _ => Ok(()),
        }
    }

    /// Whether the device takes strokes, or will after the pending operations.
    pub(super) fn takes_plays(&self) -> Result<(), CommandError> {
        self.ready()?;
        match self.state() {
            _ if self.operations.wants_armed => Ok(()),
            State::Returning => Err(CommandError::Returning),
            _ => Err(CommandError::Disarmed),
        }
    }

    fn play(
        &mut self,
        now: HostInstant,
        given: HostInstant,
        mut play: Box<Play>,
        emit: &mut dyn Emit,
    ) -> Result<(), (CommandError, Box<Play>)> {
        match self.place(now, &play) {
            Err(refused) => Err((refused, play)),
            Ok(((tick, requested), margin)) => {
                if play.replace && self.plays.iter().any(|active| !active.is_cut()) {
                    self.plays.cut(&EndCause::Replaced);
                    // Sent with the next step.
                    self.operations.queue(now, 0, Op::Stop, emit);
                }
                if self.known.no_trigger_output {
                    play.items.iter_mut().for_each(|item| item.trigger = None);
                }
                self.plays.take(Active::new(play, given, (tick, requested), margin));
                Ok(())
            }
        }
    }

    /// Decides whether a play can be queued; returns the present tick, the onset it asks for and its first margin.
    fn place(&self, now: HostInstant, play: &Play) -> Result<((Tick, Option<Tick>), Duration), CommandError> {
        self.check_array(play.strokes.array())?;
        self.takes_plays()?;
        if self.operations.will_seek() || self.homing.is_under_way() {
            return Err(CommandError::Returning);
        }
        let (Some(session), Some(tick)) = (&self.session, self.tick_at(now)) else {
            return Err(CommandError::NoDevice);
        };
        let queued = || self.plays.iter().filter(|active| !active.is_cut() && !play.replace);
        let held = self.plays.len() > 2 * MAX_QUEUED_PLAYS || self.operations.is_full();
        if queued().count() > MAX_QUEUED_PLAYS || held {
            return Err(CommandError::QueueFull);
        }
        // Its client must see at once what it does.
        if play.live.is_some() && queued().next().is_some() {
            return Err(CommandError::Playing);
        }
        let last = queued().next_back();
        if last.is_some_and(|last| last.play().strokes.end().is_none()) {
            return Err(CommandError::BehindEndless);
        }
        let has_code = |item: &Item| item.trigger.is_some_and(|trigger| trigger.code > 0);
        if self.known.no_trigger_output && play.items.iter().any(has_code) {
            return Err(CommandError::NoTriggerOutput);
        }
        let rate = self.rate();
        let too_far = CommandError::TooFar { most_min: (FARTHEST / rate.per_s() / 60) as u32 };
        self.check_drift(tick, play)?;
        let margin = margin(session, play, &self.control, &self.known)?;
        let requested = match play.at {
            At::Next => return Ok(((tick, None), margin)),
            At::Edge(_) if !self.known.trigger_input => return Err(CommandError::NoTriggerInput),
            At::Edge(ns) => {
                let (delay, least) = (edge_delay(rate, ns), margin + EDGE_REPORTED);
                return match delay {
                    _ if delay < rate.duration_to_ticks(least) => {
                        Err(CommandError::EdgeTooSoon { least_ms: least.as_micros().div_ceil(1000) as u32 })
                    }
                    _ if delay > FARTHEST => Err(too_far),
                    _ => Ok(((tick, None), margin)),
                };
            }
            _ if queued().any(Active::waits_for_edge) => return Err(CommandError::BehindEdge),
            At::Tick(tick) => tick,
            At::Monotonic(at) if rate.duration_to_ticks(at.since(now)) > FARTHEST => {
                return Err(too_far);
            }
            At::Monotonic(at) => session.clock().estimate().ok_or(CommandError::NoDevice)?.nearest_tick(at),
            At::After(ns) => session
                .clock()
                .tick_at(now + Duration::from_nanos(ns))
                .map(|at| at.max(tick + rate.duration_to_ticks(margin)))
                .ok_or(CommandError::NoDevice)?,
        };
        if requested < tick + rate.duration_to_ticks(margin) {
            return Err(CommandError::TooSoon);
        }
        if requested - tick > FARTHEST {
            return Err(too_far);
        }
        // A play without an onset follows the one before it: this is the best estimate of its end.
        let free = queued().fold(tick, |free, active| {
            active.end().unwrap_or(
                free + rate.duration_to_ticks(FIRST_MARGIN) + active.play().strokes.end().unwrap_or(0),
            )
        });
        if requested < free {
            return Err(CommandError::Overlaps);
        }
        Ok(((tick, Some(requested)), margin))
    }

    /// Refuses a play of pins that may be too far from rest.
    fn check_drift(&self, tick: Tick, play: &Play) -> Result<(), CommandError> {
        let (um, limit_um) =
            (self.control.dead_reckoning_um(tick, play.strokes.motors()), self.settings.drift_limit_um);
        if um <= limit_um {
            return Ok(());
        }
        Err(CommandError::DriftLimit { um: um.round() as u32, limit_um: limit_um.round() as u32 })
    }

    /// Ends a live play for its client.
    fn end_live(&mut self, id: u64) -> OpResult {
        if !self.plays.iter().any(|active| is_live(active, id)) {
            return Ok(None);
        }
        self.plays.cut(&EndCause::Stop);
        Ok(Some(Op::Stop))
    }

    fn stop(&mut self) -> OpResult {
        self.ready()?;
        if self.operations.is_full() {
            return Err(CommandError::Returning);
        }
        self.plays.cut(&EndCause::Stop);
        Ok(Some(Op::Stop))
    }

    /// Ends one play. A play that waits is ended without an operation, because an operation would cut the plays before it.
    fn cancel(&mut self, id: u64, cause: EndCause) -> OpResult {
        let found = self.plays.iter_mut().find(|active| active.play().id == id && !active.is_cut());
        let Some(active) = found else { return Ok(None) };
        let waits = active.phase() == Phase::Waiting && active.play().live.is_none();
        if !waits && self.operations.is_full() {
            return Err(CommandError::Returning);
        }
        if waits {
            active.cut_unsent(cause);
            return Ok(None);
        }
        active.cut(cause);
        self.plays.cut(&EndCause::Stop);
        Ok(Some(Op::Stop))
    }

    /// Homes all pins: by one seek of the lower stop, or by moves, which the streamer then sends by and by.
    fn home(&mut self, ticket: u64) -> OpResult {
        self.takes_plays()?;
        let by_stop = self.settings.lower_stop.is_some();
        let busy = !self.operations.is_empty() || (!by_stop && self.homing.is_moving());
        if self.state() != State::Armed || busy {
            return Err(CommandError::Returning);
        }
        if !self.plays.is_empty() {
            return Err(CommandError::Playing);
        }
        if by_stop {
            return Ok(Some(Op::Seek { pulses: self.settings.seek_pulses() }));
        }
        let Some((_, tick)) = self.known.status else { return Err(CommandError::NoDevice) };
        if self.array().numbers().all(|motor| self.control.offset_um(motor, tick).is_none()) {
            return Err(CommandError::NoPositionEstimate);
        }
        self.homing.begin(ticket, tick);
        Ok(None)
    }

    fn disarm(&mut self) -> OpResult {
        self.ready()?;
        self.operations.wants_armed = false;
        self.plays.cut(&EndCause::Disarm);
        Ok(Some(Op::Disarm(Cause::Request)))
    }

    fn arm(&mut self, now: HostInstant, rest: Rest) -> OpResult {
        self.ready()?;
        let is_known = self.known.status.is_some_and(|(status, _)| status.position_known);
        if rest == Rest::Unchecked && self.known.status.is_none() {
            // It may know where its pins are.
            return Err(CommandError::NoDevice);
        }
        // Unless a person has checked, the device returns the pins that it knows to be above rest.
        let assume_rest = rest == Rest::Checked || (rest == Rest::Unchecked && !is_known);
        // An operation begins a new epoch: do not send one between a play and its strokes for nothing.
        match self.state() {
            State::Armed if self.operations.wants_armed => {
                if rest != Rest::Known {
                    if !self.plays.is_empty() || self.homing.is_moving() {
                        return Err(CommandError::Playing);
                    }
                    self.take_rest(now, rest)?;
                }
                return Ok(None);
            }
            State::Armed | State::Returning if !self.operations.wants_armed => {
                return Err(CommandError::Returning);
            }
            State::Returning => return Ok(None),
            _ if self.homing.is_resetting() => return Err(CommandError::Returning),
            _ if self.operations.wants_armed => return Err(CommandError::Returning),
            _ => {}
        }
        self.take_rest(now, rest)?;
        self.operations.wants_armed = true;
        self.control.clear_faults();
        let seeks = !is_known || self.homing.needs_seek(now);
        Ok(Some(self.arm_op(assume_rest, seeks)))
    }

    /// Arms with the settings in use; on an array with a lower stop it may seek that.
    pub(super) fn arm_op(&self, assume_rest: bool, seeks: bool) -> Op {
        let host_timeout = self.rate().ms_in_ticks(self.settings.lease_ms).round() as u32;
        let lower_stop = self.settings.lower_stop.map(|stop| {
            let seek = if seeks { self.settings.seek_pulses() } else { 0 };
            LowerStop { pulses_per_s: stop.pulses_per_s, seek }
        });
        Op::Arm { assume_rest, host_timeout, limits: self.settings.limits, lower_stop }
    }

    /// Takes pins as at rest, because a client says so. If telemetry shows all pins, nothing changes: should it not come back,
    /// the estimate from before stays. Without telemetry, only a look at the pins ends the estimate; until then it sums up over
    /// all that is played, and over all heights that cuts have left and that no device returns any more. Those that stand are returned.
    fn take_rest(&mut self, now: HostInstant, rest: Rest) -> Result<(), CommandError> {
        if rest == Rest::Known || self.control.sees_all() {
            return Ok(());
        }
        if rest == Rest::Checked {
            self.control.assume_rest();
            return Ok(());
        }
        // The account of a play that was cut is not closed: its estimate may still grow.
        if !self.plays.is_empty() {
            return Err(CommandError::Returning);
        }
        let tick = self.tick_at(now).unwrap_or_default();
        self.control.reckon_to(tick);
        let um = self.control.returned_reckoning_um(tick);
        if um > LEVEL_CHECK_UM {
            return Err(CommandError::LevelNotChecked { um: um.round() as u32 });
        }
        Ok(())
    }

    /// Overtakes all other operations.
    fn emergency_stop(&mut self, now: HostInstant, ticket: u64, emit: &mut dyn Emit) {
        self.latch.close(ticket);
        self.plays.cut(&EndCause::EStop);
        self.homing.end(Err(CommandError::Returning), emit);
        self.homing.end_seek(Err(CommandError::Faulted), emit);
        self.homing.end_reset(Err(CommandError::Faulted), emit);
        self.reports.hasten(now);
        if self.operations.overtake(now, ticket, self.session.is_some(), emit) {
            self.operations.send_next(self.session.as_mut(), &mut self.control);
        }
    }

    fn reset(&mut self, estops_seen: u64) -> OpResult {
        let faulted = self.state() == State::Faulted;
        self.latch.open(estops_seen)?;
        let open = self.session.as_ref().is_some_and(Session::can_command);
        Ok((open && faulted).then_some(Op::Reset))
    }

    /// Orders an operation that `ticket` waits for.
    pub(super) fn order(&mut self, given: HostInstant, ticket: u64, op: Op, emit: &mut dyn Emit) {
        self.operations.order(given, ticket, op, self.session.as_mut(), &mut self.control, emit);
    }
}
