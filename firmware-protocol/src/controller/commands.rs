//! Hands each message of the host to the part of the controller that handles it.
//!
//! Invariant: a command is carried out once, in the epoch that it begins; moves and amendments of another epoch change nothing.

use crate::controller::Controller;
use crate::controller::stream::Next;
use crate::limits::Refusal;
use crate::message::{Cause, HostMessage, Op, State};

impl Controller {
    /// Handles a message of the host, except for the moves or amendments in it: they are taken next.
    pub(super) fn handle(&mut self, message: HostMessage<'_>) {
        if let HostMessage::Hello { session } = message {
            self.open(session);
            return;
        }
        if !self.session.is_open() {
            self.reporting.pending.no_session = true;
            return;
        }
        if let HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch } = message {
            // It is handled when all its strokes could be read.
            let head = Next { seq, mark, withdraw, base: base.near(self.now) };
            let (stream, mut parts) = self.stream();
            stream.receive(head, Some((epoch, seen)), batch, &mut parts);
            return;
        }
        self.session.last_heard = self.now;
        // These two have an answer of their own.
        if !matches!(message, HostMessage::Board { .. } | HostMessage::SelfTest { .. }) {
            self.reporting.pending.status = true;
        }
        match message {
            HostMessage::Hello { .. } | HostMessage::Moves { .. } => {}
            HostMessage::Board { window } => self.board.ask(window),
            HostMessage::SelfTest { run } => self.board.ask_test(run, self.motion.state() == State::Disarmed),
            HostMessage::Ping { token, seen } => {
                self.session.token = token;
                self.reporting.seen(seen, self.now);
            }
            HostMessage::Control { epoch, seen, op } => {
                self.reporting.seen(seen, self.now);
                self.control(epoch, op);
            }
            HostMessage::Amend { epoch, generation, base, items } => {
                if epoch == self.session.epoch() {
                    self.stream.receive_amendments(epoch, generation, base.near(self.now), items);
                }
            }
        }
    }

    /// Opens a session, unless it is open already.
    pub(super) fn open(&mut self, session: u32) {
        self.reporting.pending.hello = true;
        self.session.last_heard = self.now;
        if self.session.id == Some(session) {
            return;
        }
        self.disarm(Cause::NewHost);
        self.session.open(session);
        self.stream.begin();
        self.reporting.forget_reports();
        self.board.forget_requests();
        self.player.forget_marks();
    }

    /// Carries out a command if its epoch is new.
    pub(super) fn control(&mut self, epoch: u16, op: Op) {
        if self.session.begin(epoch) {
            self.stream.begin();
            self.board.end_test();
            self.session.refusal = self.perform(op).err();
        }
    }

    fn perform(&mut self, op: Op) -> Result<(), Refusal> {
        let Self { motion, player, reporting, .. } = self;
        match op {
            Op::Arm { assume_rest, host_timeout, limits, lower_stop } => {
                motion.arm(assume_rest, limits, lower_stop, player, reporting)?;
                self.session.host_timeout = host_timeout.min(player.layout().max_host_timeout());
            }
            Op::Disarm(cause) => self.disarm(cause),
            Op::Stop => motion.stop(self.now, player, reporting),
            Op::EStop => self.off(Cause::EStop),
            Op::Reset => motion.reset(),
            Op::Move { motor, direction, pulses } => motion.shift(motor, direction, pulses, player)?,
            Op::Seek { pulses } => motion.seek(pulses, player, reporting)?,
        }
        Ok(())
    }
}
