//! Passes what the device says to the parts of a session.
//!
//! Each message passes its bounds (`bounds`) first; the session ignores one that cannot be true, and counts it.
//! The session concludes an acknowledged frame only once it has read all reports that the acknowledgement counts: the
//! device accepted every stroke that no report names.

use crate::link::session::batch::judged;
use crate::link::session::bounds::{ClockReading, DeviceKnowledge, Sent};
use crate::link::session::contradiction::Contradiction;
use crate::link::session::event::{AnotherArray, Event, LostReason};
use crate::link::session::pinger::RoundTrip;
use crate::link::session::reports::Reported;
use crate::link::session::{Phase, Session};
use crate::time::HostInstant;
use firmware_protocol::board::{Board, SelfTestState};
use firmware_protocol::message::{DeviceHello, DeviceMessage, Op, Report, Status};
use firmware_protocol::tick::Tick;
use std::time::Duration;

/// The device learns within this time that its reports were read. Until then it sends [`REPORTS`] of them: 8 000 a second, more
/// than the paper's motors make at 300 Hz, so none waits.
///
/// [`REPORTS`]: firmware_protocol::controller::REPORTS
const SEEN_WITHIN: Duration = Duration::from_millis(4);

impl Session {
    /// Takes bytes from the device, in any chunks.
    pub fn receive(&mut self, now: HostInstant, mut bytes: &[u8], emit: &mut dyn FnMut(Event)) {
        self.wire.received(bytes.len());
        while let Some(message) = self.wire.next(&mut bytes) {
            match message {
                Ok(message) => {
                    if let Err(how) = self.handle(now, message, emit) {
                        self.contradicts(now, how, emit);
                    }
                }
                Err(_) if matches!(self.phase, Phase::Opening | Phase::Open) => {
                    self.lose(LostReason::Version, emit);
                }
                Err(_) => {}
            }
        }
    }

    /// The device contradicted itself. One contradiction is counted; several in a row close the link.
    fn contradicts(&mut self, now: HostInstant, how: Contradiction, emit: &mut dyn FnMut(Event)) {
        if self.wire.contradicted(how) {
            emit(Event::Contradiction(how));
        }
        if self.trust.contradicted(now) {
            self.distrust(how, emit);
        } else {
            // The next status shows soon which of the two was wrong.
            self.pinger.hasten();
        }
    }

    fn handle(
        &mut self,
        now: HostInstant,
        message: DeviceMessage,
        emit: &mut dyn FnMut(Event),
    ) -> Result<(), Contradiction> {
        self.pinger.heard();
        match message {
            DeviceMessage::Hello(hello) if self.phase == Phase::Opening => self.opened(now, hello, emit)?,
            DeviceMessage::Hello(_) => {}
            _ if self.phase != Phase::Open => {}
            DeviceMessage::NoSession => self.lose(LostReason::Restarted, emit),
            DeviceMessage::Status(status) => self.status(now, status, emit)?,
            DeviceMessage::Report { number, report } => {
                if self.reports.receive(number, report) {
                    self.read_reports(now, emit)?;
                }
            }
            DeviceMessage::Board(board) => self.board(board, emit)?,
            DeviceMessage::SelfTest { run, state } => self.self_test(run, state, emit)?,
            DeviceMessage::Telemetry { tick, first, y } => {
                let tick = self.known.read_telemetry(self.reading(now)?, tick, first, y.as_slice())?;
                if let Some(y) = self.telemetry.take(tick, first, y.as_slice()) {
                    emit(Event::Telemetry { tick, y, known_to: self.known_to() });
                }
            }
        }
        Ok(())
    }

    /// The device's clock, which the handshake has set.
    fn reading(&self, now: HostInstant) -> Result<ClockReading, Contradiction> {
        self.pinger.reading(now).ok_or(Contradiction::Clock)
    }

    fn opened(
        &mut self,
        now: HostInstant,
        hello: DeviceHello,
        emit: &mut dyn FnMut(Event),
    ) -> Result<(), Contradiction> {
        if hello.session != self.id {
            return Ok(());
        }
        let array = self.known.array();
        if hello.array != array {
            self.lose(LostReason::WrongArray(AnotherArray { device: hello.array, array }), emit);
            return Ok(());
        }
        DeviceKnowledge::read_hello(&hello)?;
        self.phase = Phase::Open;
        self.commands.open(hello.epoch);
        self.reports.open(hello.reports);
        // The device may answer any of the hellos. Its session, and its reports, begin with the first one that it hears.
        let first = self.hellos.first().unwrap_or(now);
        self.pinger.open(first, Tick(hello.tick), now);
        self.known.open(&hello, [self.reading(first)?.earliest(), self.reading(now)?.latest()]);
        emit(Event::Opened(hello));
        Ok(())
    }

    fn status(
        &mut self,
        now: HostInstant,
        status: Status,
        emit: &mut dyn FnMut(Event),
    ) -> Result<(), Contradiction> {
        let pinged = self.pinger.sent_at(status.token);
        let sent = Sent {
            pinged: pinged.and_then(|sent| self.pinger.reading(sent)),
            epoch: self.commands.epoch(),
            command: self.commands.waiting(),
            acked: self.outbox.acked(),
            frames: self.outbox.unacknowledged(),
            seen: self.reports.seen(),
        };
        let (tick, is_newest) = self.known.read_status(&status, self.reading(now)?, &sent)?;
        if let Some(sent) = pinged {
            self.pinger.answered(status.token);
            if !self.line.answered(now, status.token, self.pinger.shortest()) {
                self.pinger.measured(RoundTrip { sent, tick, received: now });
            }
        }
        if !is_newest {
            // A later status overtook it, and says all this and more.
            return Ok(());
        }
        self.known.status(status, tick, sent.epoch);
        self.line.quality.heard(status.counters.bad_frames);
        self.reports.announce(status.reports);
        let mut answered = None;
        if status.epoch == sent.epoch {
            answered = self.commands.answer();
            if answered.is_some() {
                self.reports.make_stale(status.reports);
            }
            if matches!(answered, Some(Op::Arm { .. })) {
                self.pinger.ping_at(now);
            }
            self.outbox.acknowledge(&status);
        }
        self.reports.status(Reported { reports: status.reports, tick, next_seq: self.outbox.acked() });
        if !self.reports.are_complete() {
            // A report is missing: the device repeats it once it hears from the host.
            self.pinger.hasten();
        }
        emit(Event::Status { status, tick });
        if answered.is_some() {
            emit(Event::Control(status.refusal.map_or(Ok(()), Err)));
        }
        self.conclude(now, emit);
        Ok(())
    }

    /// Reads the reports that are next in order.
    fn read_reports(&mut self, now: HostInstant, emit: &mut dyn FnMut(Event)) -> Result<(), Contradiction> {
        while let Some((number, report)) = self.reports.next() {
            self.report(now, number, report, emit)?;
        }
        // The next ping tells the device that they are read.
        self.pinger.hasten_within(SEEN_WITHIN);
        self.conclude(now, emit);
        Ok(())
    }

    fn report(
        &mut self,
        now: HostInstant,
        number: u16,
        report: Report,
        emit: &mut dyn FnMut(Event),
    ) -> Result<(), Contradiction> {
        let stale = self.commands.is_waiting() || self.reports.is_stale(number);
        let frame = judged(&report).and_then(|seq| self.outbox.unjudged(seq));
        let clock = self.reading(now)?;
        let tick = self.known.read_report(&report, clock, frame, stale)?;
        self.known.report(&report, tick, clock.latest());
        self.reports.read(number);
        match report {
            Report::Verdict { .. } | Report::OnsetRefused { .. } => self.outbox.judge(number, report, stale),
            Report::Onset { counters, .. } => emit(Event::Onset { tick, counters }),
            Report::Cut(cut) => emit(Event::Cut { cut, at: tick }),
            Report::Refused { motor, reason, .. } => emit(Event::StrokeRefused { motor, up: tick, reason }),
            Report::Lowered { late, held, .. } => emit(Event::Lowered { late, held, tick }),
            Report::Edge { number, .. } => emit(Event::Edge { tick, number }),
        }
        Ok(())
    }

    /// Emits the verdicts that the statuses and reports so far decide.
    fn conclude(&mut self, now: HostInstant, emit: &mut dyn FnMut(Event)) {
        let Reported { next_seq, .. } = self.reports.conclude();
        if let Some(tick) = self.pinger.clock().tick_at(now) {
            self.outbox.conclude(next_seq, tick, now, emit);
        }
    }

    fn board(&mut self, board: Board, emit: &mut dyn FnMut(Event)) -> Result<(), Contradiction> {
        if self.asking.awaits(&board) {
            self.known.read_board(&board, self.asking.last())?;
            self.asking.answer(board);
            emit(Event::Board(board));
        }
        Ok(())
    }

    fn self_test(
        &mut self,
        run: u16,
        state: SelfTestState,
        emit: &mut dyn FnMut(Event),
    ) -> Result<(), Contradiction> {
        if self.asking.awaits_test(run) {
            self.known.read_self_test(state)?;
            if state != SelfTestState::Running {
                self.asking.end_test();
                emit(Event::SelfTest(state));
            }
        }
        Ok(())
    }
}
