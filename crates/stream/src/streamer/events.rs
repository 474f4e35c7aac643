//! Handles what the device reports: answers, status, verdicts on strokes, onsets, cuts and telemetry.
//!
//! [`Streamer::receive`] passes bytes to the link session, whose events are handled here.

use crate::active::{Active, FIRST_MARGIN, Phase};
use crate::control::Cutting;
use crate::link::{Event, LostReason, Verdict};
use crate::queues::{CommandError, Edge, Emit, Stamp, StreamEvent};
use crate::streamer::operations::{answer, cuts_play, seeks};
use crate::streamer::{IDLE_PING, Streamer, end_cause};
use crate::time::HostInstant;
use firmware_protocol::controller::HORIZON;
use firmware_protocol::message::{Cause, Counters, Op, State, Status};
use firmware_protocol::tick::Tick;
use meissner_api::{EdgeEffect, EndCause, LateCause};
use meissner_array::strokes::Step;
use meissner_array::units::ms_to_duration;
use std::time::Duration;

/// A frame that left this long before its stroke was sent in time: if the stroke is late, the link was slow.
const IN_TIME: Duration = Duration::from_millis(3);

impl Streamer {
    /// Takes bytes from the device.
    pub fn receive(&mut self, now: HostInstant, bytes: &[u8], emit: &mut dyn Emit) {
        let Some(session) = &mut self.session else { return };
        let events = &mut self.events;
        session.receive(now, bytes, &mut |event| events.push_back(event));
        self.handle_link_events(now, emit);
    }

    pub(super) fn handle_link_events(&mut self, now: HostInstant, emit: &mut dyn Emit) {
        while let Some(event) = self.events.pop_front() {
            self.event(now, event, emit);
        }
    }

    fn event(&mut self, now: HostInstant, event: Event, emit: &mut dyn Emit) {
        match event {
            Event::Opened(hello) => {
                if self.known.opened(&hello) {
                    self.control.restarted();
                }
                self.control.connected(self.known.telemetry);
                emit.event(StreamEvent::Connected(hello));
                if self.latch.is_closed() {
                    self.order(now, 0, Op::EStop, emit);
                }
            }
            Event::Lost(reason) => {
                // The session has sent an e-stop of its own. Only the next session resets it.
                let own = matches!(reason, LostReason::Contradicts(_)) && self.state() != State::Faulted;
                self.latch.session_over(own);
                self.disconnect(now, EndCause::Other(reason.text()), emit);
            }
            Event::Contradiction(how) => emit.event(StreamEvent::Contradiction(how)),
            Event::Control(result) => {
                if let Some(done) = self.operations.answered() {
                    if result.is_err() && !matches!(done.op, Op::Move { .. } | Op::Seek { .. }) {
                        self.operations.wants_armed = false;
                        self.plays.cut(&EndCause::CommandRefused);
                    }
                    // The client must see the new state when it gets the answer.
                    emit.event(StreamEvent::Snapshot(self.snapshot(now)));
                    if result.is_ok() && seeks(&done.op) {
                        // The answer comes when the pins are at the stop.
                        self.homing.begin_seek(done.ticket, &done.op, emit);
                        if let Some((status, _)) = self.known.status {
                            self.homing.settle_seek(now, &status, &mut self.control, emit);
                        }
                    } else {
                        answer(done.ticket, result.map_err(CommandError::Device), emit);
                    }
                    if cuts_play(&done.op) {
                        self.cut_control(now);
                        self.note_standing(now);
                    }
                    let (tick, result) =
                        (self.tick_at(now).unwrap_or_default(), result.map_err(CommandError::Device));
                    self.homing.moved(tick, done.op, result, &mut self.control, emit);
                    // The device may have disarmed in the meantime.
                    if let (true, Some((status, _))) = (self.operations.is_empty(), self.known.status)
                        && !matches!(status.state, State::Armed | State::Returning)
                    {
                        self.operations.wants_armed = false;
                        self.plays.cut(&end_cause(status.cause));
                    }
                }
            }
            Event::Status { status, tick } => self.status(now, status, tick, emit),
            Event::Step(step, verdict) => self.verdict(now, &step, verdict, emit),
            Event::Replaced { motors, kept } => {
                self.control.replaced(motors, kept);
                let rate = self.rate();
                self.live.replaced(motors, kept, &mut self.plays, rate, emit);
            }
            Event::OnsetRefused { rendered } => self.onset_refused(now, rendered),
            Event::OnsetAccepted => {
                if let Some(active) = self.plays.iter_mut().find(|active| active.phase() == Phase::Offered) {
                    active.onset_accepted();
                }
            }
            Event::Onset { tick, counters } => self.onset(tick, counters, emit),
            Event::Cut { cut, at } => {
                let cutting = Cutting { at, returned: cut.return_ticks.map(|ticks| at + u64::from(ticks)) };
                self.cut_at(cutting);
                // A return that is over by now leaves nothing.
                if self.state() != State::Armed || cutting.returned.is_none() {
                    self.control.was_cut(cutting, cut.outstanding);
                }
                // A report from before the device was armed again does not concern the present play.
                if !matches!(cut.cause, Cause::Stop | Cause::Request) && self.state() != State::Armed {
                    self.plays.cut(&end_cause(cut.cause));
                }
                if let Some(clock) = self.session.as_ref().and_then(|session| session.clock().estimate()) {
                    self.plays.iter_mut().for_each(|active| active.was_cut(at, &clock));
                }
                // The report of a stop does not concern strokes sent after the device answered the stop.
                if self.state() != State::Armed || self.control.is_idle() {
                    self.cut_control(now);
                    self.control.moves_were_cut(cutting);
                }
                if let Some((motor, pulses)) =
                    self.homing.undo_move(self.tick_at(now).unwrap_or_default(), &mut self.control)
                    && cutting.returned.is_none()
                {
                    self.control.move_was_cut(motor, pulses);
                }
                self.note_standing(now);
                self.reports.hasten(now);
            }
            Event::StrokeRefused { motor, up, reason } => {
                let moves = self.control.refused_as_begun(motor, up);
                let Self { plays, control, .. } = self;
                if let Some(active) = plays.owner(up) {
                    let queued = control.queued(motor, up);
                    active.refused_as_begun((motor, up), moves, queued, |span| control.span(span));
                    let id = active.play().id;
                    emit.event(StreamEvent::StrokeRefused { id, motor, up, reason });
                }
            }
            Event::Lowered { late, held, tick } => {
                // What a late move has lowered follows from its verdict.
                self.control.hold_ended(held, tick);
                if let Some(active) = self.plays.owner(tick) {
                    emit.event(StreamEvent::PinsLowered { id: active.play().id, tick, late, held });
                }
                if let Some(strokes) = self.plays.iter_mut().find_map(Active::live_strokes) {
                    held.iter().for_each(|motor| strokes.hold_ended(motor, tick));
                }
            }
            Event::Edge { tick, number } => self.edge(now, tick, number, emit),
            Event::Board(board) => {
                self.known.board = Some(board);
                self.plays.iter_mut().for_each(|active| active.board().heard(board));
            }
            // The streamer asks for none.
            Event::SelfTest(_) => {}
            Event::Telemetry { tick, y, known_to } => {
                let known = self.control.telemetry(tick, &y, known_to, |burst| emit.measured(burst));
                if let (false, Some(session)) = (known, &mut self.session) {
                    session.request_status();
                }
            }
        }
    }

    /// The device has flushed its queue, at most the render horizon after its last status: counts what was played until now.
    fn cut_control(&mut self, now: HostInstant) {
        let now = self.tick_at(now);
        let reported = self.known.status.map(|(_, tick)| tick + u64::from(HORIZON));
        self.control.cut(reported.or(now).unwrap_or_default(), now);
    }

    /// The device has cut the plays that had begun, or their return. It may report the onset of the last one later: it cuts up to
    /// the render horizon ahead.
    fn cut_at(&mut self, cut: Cutting) {
        for active in self.plays.iter_mut().filter(|active| active.phase() != Phase::Waiting) {
            if active.cut_at().is_some() {
                active.note_return_cut_at(cut.at);
                continue;
            }
            let Some(onset) = active.onset().filter(|&onset| onset < cut.at) else { continue };
            if active.end().is_none_or(|end| end > cut.at) {
                let over = self.control.over_at(onset, active.until(), Some(cut));
                active.note_cut_at(cut.at, over);
            }
        }
    }

    fn status(&mut self, now: HostInstant, status: Status, tick: Tick, emit: &mut dyn Emit) {
        let changed = self.known.heard(status, tick, &mut self.control);
        if status.outstanding == 0 && status.state != State::Returning {
            self.control.are_down(tick);
        }
        if self.latch.resets_own(&status) && self.operations.is_empty() {
            self.order(now, 0, Op::Reset, emit);
        }
        self.homing.settle_seek(now, &status, &mut self.control, emit);
        if status.state == State::Armed && !self.operations.is_in_flight() {
            self.control.at_rest(tick);
        }
        if !changed {
            self.note_standing(now);
            return;
        }
        self.reports.hasten(now);
        let armed = matches!(status.state, State::Armed | State::Returning);
        let host_timeout = ms_to_duration(self.settings.lease_ms);
        if let Some(session) = &mut self.session {
            session.keep_alive_every(if armed { host_timeout / 5 } else { IDLE_PING }, now);
            // If this status was a lie, the next one contradicts it while the device is still fed.
            session.request_status();
        }
        if !armed && self.operations.is_empty() {
            self.operations.wants_armed = false;
            self.plays.cut(&end_cause(status.cause));
            self.cut_control(now);
            self.homing.end(Err(CommandError::Disarmed), emit);
        }
        self.note_standing(now);
    }

    /// Notes which pins stand above rest while the device does nothing, and since when.
    fn note_standing(&mut self, now: HostInstant) {
        if let Some((status, tick)) = self.known.status
            && matches!(status.state, State::Disarmed | State::Faulted)
            && self.operations.is_empty()
            && status.position_known
        {
            self.control.stands(status.outstanding, tick);
        }
        self.standing_since =
            (self.control.highest_standing() > 0).then(|| self.standing_since.unwrap_or(now));
    }

    fn verdict(&mut self, now: HostInstant, step: &Step, verdict: Verdict, emit: &mut dyn Emit) {
        let in_time = self.rate().duration_to_ticks(IN_TIME);
        let sent_tick = |sent| self.tick_at(sent).unwrap_or_default();
        let cause = match verdict {
            Verdict::Late { retransmitted: true, .. } => LateCause::Link,
            Verdict::Late { sent, .. } if sent_tick(sent) + in_time > step.begin() => LateCause::Host,
            _ => LateCause::Link,
        };
        let (motor, up) = (step.motor(), step.begin());
        match verdict {
            Verdict::Accepted => self.control.accepted(motor, up),
            Verdict::Refused(_) => self.control.withdrawn(motor, up),
            Verdict::Late { rendered, .. } => self.control.late(motor, up, rendered),
            // Position control has forgotten it with the replacement that failed.
            Verdict::Superseded => {}
        }
        let Some(active) = self.plays.owner(up) else { return };
        active.decided(step, verdict == Verdict::Accepted);
        let id = active.play().id;
        match verdict {
            Verdict::Accepted | Verdict::Superseded => {}
            Verdict::Refused(reason) => {
                active.refused(motor, up, step.moves() as u64);
                emit.event(StreamEvent::StrokeRefused { id, motor, up, reason });
            }
            Verdict::Late { rendered, .. } => {
                if self.plays.late(step, rendered, cause, self.settings.array.rate(), emit) {
                    self.operations.abort(now, self.session.as_mut(), &mut self.control, emit);
                }
            }
        }
    }

    fn onset_refused(&mut self, now: HostInstant, rendered: Tick) {
        let longest = ms_to_duration(self.settings.lead_ms).max(FIRST_MARGIN * 32);
        let Some(active) = self.plays.iter_mut().find(|active| active.phase() == Phase::Offered) else {
            return;
        };
        if let Some(onset) = active.onset_refused(rendered, longest) {
            self.control.withdraw_from(onset);
        }
        self.feed.back_to(rendered);
        self.reports.hasten(now);
    }

    /// An edge of the trigger input stops the play that runs, if that asks for it; or starts the first one that waits for an edge, if
    /// the plays before it were over. It is reported in any case, as soon as the clock is known.
    fn edge(&mut self, now: HostInstant, tick: Tick, number: u32, emit: &mut dyn Emit) {
        let clock = self.session.as_ref().and_then(|session| session.clock().estimate());
        let Some(stamp) = clock.map(|clock| Stamp::new(tick, &clock)) else { return };
        let (edge, present) = (Edge { number, at: stamp }, self.tick_at(now).unwrap_or(tick));
        let runs = self.plays.iter_mut().rev().find(|active| active.runs_at(tick));
        let (play, effect) = if let Some(active) = runs {
            let id = active.play().id;
            let stops = active.stops_by_edge(tick, present) && !self.operations.is_full();
            if stops {
                active.stop_by(edge);
                self.plays.cut(&EndCause::Stop);
                self.order(now, 0, Op::Stop, emit);
            }
            (Some(id), if stops { EdgeEffect::Stop } else { EdgeEffect::Mark })
        } else {
            let is_over = |active: &Active| active.is_cut() || active.end().is_some_and(|end| end <= tick);
            let first = self.plays.iter_mut().find(|active| !is_over(active));
            let started = first.and_then(|active| active.take_edge(edge).then(|| active.play().id));
            (started, if started.is_some() { EdgeEffect::Start } else { EdgeEffect::Mark })
        };
        emit.event(StreamEvent::Edge { edge, play, effect });
    }

    fn onset(&mut self, tick: Tick, counters: Counters, emit: &mut dyn Emit) {
        let clock = self.session.as_ref().and_then(|session| session.clock().estimate());
        let Some(stamp) = clock.map(|clock| Stamp::new(tick, &clock)) else { return };
        // An item's concerns its own account, a play's the whole.
        for active in self.plays.iter_mut() {
            active.reported(stamp);
        }
        let Some(active) = self.plays.iter_mut().find(|active| active.onset() == Some(tick)) else { return };
        self.control.reckon_to(tick);
        let onset = active.began(stamp, counters, self.control.rest_error_um(tick));
        emit.event(StreamEvent::PlayStarted { id: active.play().id, onset });
    }
}
