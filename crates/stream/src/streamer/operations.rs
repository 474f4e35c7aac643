//! The operations for the device, one at a time, and the requests that wait for its answers.
//!
//! It does not decide whether an operation is possible, and touches no play: it says what has become of an operation.
//!
//! Invariant: each ticket gets exactly one answer; a late arm never enables motors when nobody expects it.

use crate::control::PositionControl;
use crate::link::Session;
use crate::queues::{CommandError, ESTOP_TICKETS, Emit, StreamEvent};
use crate::time::HostInstant;
use firmware_protocol::message::{Cause, Op};
use std::collections::VecDeque;
use std::time::Duration;

/// How long an answer may take.
pub(super) const ANSWER_WITHIN: Duration = Duration::from_secs(1);
/// Most operations that wait for the device.
const MOST: usize = 8;

/// An operation for the device, and the request that waits for it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pending {
    pub(super) ticket: u64,
    pub(super) op: Op,
    since: HostInstant,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Operations {
    /// Oldest first.
    pending: VecDeque<Pending>,
    /// The first is sent and not answered.
    in_flight: bool,
    /// Whether the device is armed, or will be after these operations.
    pub(super) wants_armed: bool,
    /// The request for the shutdown, and since when it waits.
    closing: Option<(u64, HostInstant)>,
    closed: bool,
}

impl Operations {
    pub(super) fn new() -> Self {
        let pending = VecDeque::with_capacity(MOST);
        Self { pending, in_flight: false, wants_armed: false, closing: None, closed: false }
    }

    /// Queues an operation that `ticket` waits for, unless too many wait. Returns whether it did.
    pub(super) fn queue(&mut self, given: HostInstant, ticket: u64, op: Op, emit: &mut dyn Emit) -> bool {
        if matches!(op, Op::Disarm(_)) {
            // A disarm makes pending operations pointless, and must not wait for them.
            self.refuse_after(usize::from(self.in_flight), CommandError::Returning, emit);
        }
        let room = !self.is_full();
        if room {
            self.pending.push_back(Pending { ticket, op, since: given });
        } else {
            answer(ticket, Err(CommandError::Timeout), emit);
        }
        room
    }

    /// Removes the operations after the first `kept`, newest first.
    fn refuse_after(&mut self, kept: usize, why: CommandError, emit: &mut dyn Emit) {
        while self.pending.len() > kept {
            let Some(waiting) = self.pending.pop_back() else { break };
            answer(waiting.ticket, Err(why), emit);
        }
    }

    /// An emergency stop overtakes all other operations. If an earlier one is on its way, one answer of the device is for both.
    /// Returns whether there is one to send.
    pub(super) fn overtake(
        &mut self,
        now: HostInstant,
        ticket: u64,
        connected: bool,
        emit: &mut dyn Emit,
    ) -> bool {
        self.wants_armed = false;
        let waits = self.pending.front().is_some_and(|first| first.op == Op::EStop);
        self.refuse_after(usize::from(waits), CommandError::Faulted, emit);
        match self.pending.front_mut() {
            // Of the switch's tickets, the answer to the newest answers all.
            Some(first) => {
                let earlier = std::mem::replace(&mut first.ticket, ticket);
                match earlier {
                    // Nothing waited for it any more: the later one has its own time.
                    0 => first.since = now,
                    1..ESTOP_TICKETS => answer(earlier, Err(CommandError::Faulted), emit),
                    _ => {}
                }
            }
            None if connected => {
                self.in_flight = false;
                return self.queue(now, ticket, Op::EStop, emit);
            }
            // Latched, for a device that comes later.
            None if ticket < ESTOP_TICKETS => answer(ticket, Ok(()), emit),
            None => answer(ticket, Err(CommandError::NoDevice), emit),
        }
        false
    }

    /// Queues an operation that `ticket` waits for, and sends it if none is in flight.
    pub(super) fn order(
        &mut self,
        given: HostInstant,
        ticket: u64,
        op: Op,
        session: Option<&mut Session>,
        control: &mut PositionControl,
        emit: &mut dyn Emit,
    ) {
        if self.queue(given, ticket, op, emit) {
            self.send_next(session, control);
        }
    }

    /// A play aborts: returns the pins and disarms.
    pub(super) fn abort(
        &mut self,
        now: HostInstant,
        session: Option<&mut Session>,
        control: &mut PositionControl,
        emit: &mut dyn Emit,
    ) {
        self.wants_armed = false;
        self.order(now, 0, Op::Disarm(Cause::Abort), session, control, emit);
    }

    /// Sends the next operation if none is in flight.
    pub(super) fn send_next(&mut self, session: Option<&mut Session>, control: &mut PositionControl) {
        let Some(session) = session.filter(|session| !self.in_flight && session.can_command()) else {
            return;
        };
        let Some(op) = self.pending.front().map(|first| first.op) else { return };
        // The link probe measures the line while nothing can move.
        if matches!(op, Op::Arm { .. }) && !session.is_probed() {
            return;
        }
        self.in_flight = true;
        session.command(op);
        if cuts_play(&op) {
            control.will_be_cut();
        } else if seeks(&op) {
            control.will_seek();
        }
    }

    /// The device has answered the first one.
    pub(super) fn answered(&mut self) -> Option<Pending> {
        self.in_flight = false;
        self.pending.pop_front()
    }

    /// Answers operations that took too long with a timeout; returns whether an arm is given up.
    ///
    /// An arm or reset not sent yet is removed, and an arm already sent is replaced by a disarm. Everything else is sent until
    /// the device answers.
    pub(super) fn expire(
        &mut self,
        now: HostInstant,
        session: Option<&mut Session>,
        emit: &mut dyn Emit,
    ) -> bool {
        let is_over = |waiting: &&mut Pending| now.since(waiting.since) >= ANSWER_WITHIN;
        let (mut index, mut gave_up) = (usize::from(self.in_flight), false);
        while let Some(waiting) = self.pending.get_mut(index).filter(is_over) {
            answer(std::mem::take(&mut waiting.ticket), Err(CommandError::Timeout), emit);
            let op = waiting.op;
            if matches!(op, Op::Arm { .. } | Op::Reset) {
                self.pending.remove(index);
                gave_up |= matches!(op, Op::Arm { .. });
            } else {
                index += 1;
            }
        }
        if let (Some(first), Some(session)) = (self.pending.front_mut().filter(is_over), session) {
            answer(std::mem::take(&mut first.ticket), Err(CommandError::Timeout), emit);
            if matches!(first.op, Op::Arm { .. }) {
                first.op = Op::Disarm(Cause::Request);
                session.command(first.op);
                gave_up = true;
            }
        }
        self.wants_armed &= !gave_up;
        gave_up
    }

    /// The device is gone: nothing answers any more.
    pub(super) fn disconnected(&mut self, emit: &mut dyn Emit) {
        self.in_flight = false;
        self.wants_armed = false;
        while let Some(waiting) = self.pending.pop_front() {
            answer(waiting.ticket, Err(CommandError::NoDevice), emit);
        }
    }

    pub(super) const fn is_in_flight(&self) -> bool {
        self.in_flight
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pending.is_empty()
    }

    pub(super) fn is_full(&self) -> bool {
        self.pending.len() == MOST
    }

    /// Whether one of them takes pins to the lower stop, not as part of an arm.
    pub(super) fn will_seek(&self) -> bool {
        self.pending.iter().any(|pending| matches!(pending.op, Op::Seek { .. }))
    }

    /// `ticket` waits for the end of the thread.
    pub(super) const fn shut_down(&mut self, now: HostInstant, ticket: u64) {
        self.closing = Some((ticket, now));
        self.wants_armed = false;
    }

    pub(super) const fn is_closing(&self) -> bool {
        self.closing.is_some()
    }

    pub(super) const fn is_closed(&self) -> bool {
        self.closed
    }

    /// Completes a shutdown once the device is `off`, or after a timeout.
    pub(super) fn close(&mut self, now: HostInstant, off: bool, emit: &mut dyn Emit) {
        if let Some((ticket, _)) =
            self.closing.take_if(|(_, since)| off || now.since(*since) >= ANSWER_WITHIN)
        {
            self.closed = true;
            answer(ticket, if off { Ok(()) } else { Err(CommandError::Timeout) }, emit);
        }
    }
}

/// Whether an operation ends the plays.
pub(super) const fn cuts_play(op: &Op) -> bool {
    matches!(op, Op::Stop | Op::Disarm(_) | Op::EStop)
}

/// Whether an operation seeks the lower stop.
pub(super) fn seeks(op: &Op) -> bool {
    match op {
        Op::Arm { lower_stop, .. } => lower_stop.is_some_and(|stop| stop.seek > 0),
        op => matches!(op, Op::Seek { .. }),
    }
}

/// Answers the request with this ticket, if it has one.
pub(super) fn answer(ticket: u64, result: Result<(), CommandError>, emit: &mut dyn Emit) {
    if ticket != 0 {
        emit.event(StreamEvent::Answer { ticket, result });
    }
}
