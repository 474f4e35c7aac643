//! Reads what the device says: acknowledgements, credits, reports and verdicts, and puts them in order.
//!
//! Each message passes its bounds (`bounds`) first; the session ignores one that cannot be true, and counts it.
//! The session concludes an acknowledged frame only once it has read all reports that the acknowledgement counts: the
//! device accepted every stroke that no report names.

use crate::link::session::bounds::StatusRead;
use crate::link::session::contradiction::Contradiction;
use crate::link::session::event::{Event, LostReason, Verdict};
use crate::link::session::line::RoundTrip;
use crate::link::session::state::{Batch, Phase, Reported, Session};
use crate::time::HostInstant;
use firmware_protocol::batch::Strokes;
use firmware_protocol::controller::{REORDER_WINDOW, REPORTS};
use firmware_protocol::frame::{self, FrameError};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{DeviceHello, DeviceMessage, Op, Report, Status};
use firmware_protocol::stroke::{MOTORS, Stroke};
use firmware_protocol::tick::Tick;
use std::time::Duration;

/// The device learns within this time that its reports were read. Until then it sends [`REPORTS`] of them: 8 000 a second, more
/// than 24 motors at 300 Hz can make, so none waits.
const SEEN_WITHIN: Duration = Duration::from_millis(4);

impl Session {
    /// Takes bytes from the device, in any chunks.
    pub fn receive(&mut self, now: HostInstant, mut bytes: &[u8], emit: &mut dyn FnMut(Event)) {
        self.traffic.bytes_in += bytes.len() as u64;
        let mut decoder = std::mem::take(&mut self.decoder);
        while let Some(body) = decoder.next(&mut bytes) {
            match frame::read(body) {
                Ok(message) => {
                    (self.traffic.good, self.noise) = (self.traffic.good + 1, 0);
                    if let Err(how) = self.handle(now, message, emit) {
                        self.contradicts(now, how, emit);
                    }
                }
                Err(FrameError::Version(_)) if matches!(self.phase, Phase::Opening | Phase::Open) => {
                    self.lose(LostReason::Version, emit);
                }
                // Damaged on the way: the device sends again what matters.
                Err(error) => {
                    self.noise = self.noise.saturating_add(1);
                    self.traffic.bad.count(error);
                }
            }
        }
        self.decoder = decoder;
    }

    pub(super) fn lose(&mut self, reason: LostReason, emit: &mut dyn FnMut(Event)) {
        if self.phase != Phase::Over {
            self.phase = Phase::Over;
            emit(Event::Lost(reason));
        }
    }

    fn handle(
        &mut self,
        now: HostInstant,
        message: DeviceMessage,
        emit: &mut dyn FnMut(Event),
    ) -> Result<(), Contradiction> {
        self.unanswered = 0;
        match message {
            DeviceMessage::Hello(hello) if self.phase == Phase::Opening => self.opened(now, hello, emit)?,
            DeviceMessage::Hello(_) => {}
            _ if self.phase != Phase::Open => {}
            DeviceMessage::NoSession => self.lose(LostReason::Restarted, emit),
            DeviceMessage::Status(status) => self.status(now, status, emit)?,
            DeviceMessage::Report { number, report } => {
                let ahead = number.wrapping_sub(self.seen);
                if (1..=REPORTS as u16).contains(&ahead) {
                    self.early[usize::from(number) % REPORTS] = Some((number, report));
                    self.read_reports(now, emit)?;
                }
            }
            DeviceMessage::Board(board) => self.board(board, emit)?,
            DeviceMessage::SelfTest { run, state } => self.self_test(run, state, emit)?,
            DeviceMessage::Telemetry { tick, y } => {
                let (tick, known_to) = (self.read_telemetry(now, tick)?, self.known_to());
                emit(Event::Telemetry { tick, y, known_to });
            }
        }
        Ok(())
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
        if usize::from(hello.motors) != MOTORS || hello.tick_hz != firmware_protocol::tick::TICK_HZ {
            self.lose(LostReason::WrongArray, emit);
            return Ok(());
        }
        Self::read_hello(&hello)?;
        self.phase = Phase::Open;
        (self.epoch, self.first_epoch) = (hello.epoch, hello.epoch);
        (self.seen, self.announced, self.stale) = (hello.reports, hello.reports, hello.reports);
        self.latest = Reported { reports: hello.reports, ..Reported::default() };
        self.credits = 0;
        // The first statuses' ticks are widened with the hello's; later round trips outweigh its own. The device may
        // answer any of the hellos.
        let sent = self.first_hello.unwrap_or(now);
        self.clock.round_trip(sent, Tick(hello.tick), now);
        self.known.open(&hello, self.clock_by(now));
        self.ping_due = now;
        emit(Event::Opened(hello));
        Ok(())
    }

    fn status(
        &mut self,
        now: HostInstant,
        status: Status,
        emit: &mut dyn FnMut(Event),
    ) -> Result<(), Contradiction> {
        let StatusRead { tick, pinged, newest } = self.read_status(now, &status)?;
        if let Some(sent) = pinged {
            self.answered = status.token;
            // A ping behind the probe's frames measures neither the clock nor an idle round trip.
            if self.probe.answered(now, status.token, self.shortest_trip) {
                self.adopt_probe();
            } else {
                self.clock.round_trip(sent, tick, now);
                self.round_trip = (self.round_trip * 7 + now.since(sent)) / 8;
                self.shortest_trip = self.shortest_trip.min(now.since(sent));
                self.first_pings = self.first_pings.saturating_add(1);
                self.last_trip = Some(RoundTrip { sent, tick, received: now });
            }
        }
        if !newest {
            // A later status overtook it, and says all this and more.
            return Ok(());
        }
        self.known.status(status, tick, self.epoch);
        self.quality.heard(status.counters.bad_frames);
        let ahead = status.reports.wrapping_sub(self.announced);
        if ahead < u16::MAX / 2 {
            self.announced = status.reports;
        }
        let mut answered = None;
        if status.epoch == self.epoch {
            if let Some(control) = self.control.take_if(|control| control.under_way) {
                if matches!(control.op, Op::Arm { .. }) {
                    self.ping_due = now;
                }
                self.stale = status.reports;
                answered = Some(status.refusal.map_or(Ok(()), Err));
            }
            self.acked = status.next_seq;
            self.credits = status.credits.into();
            for batch in &mut self.window {
                let early = batch.seq.wrapping_sub(status.next_seq).wrapping_sub(1);
                batch.kept = usize::from(early) < REORDER_WINDOW && status.out_of_order >> early & 1 == 1;
            }
        }
        self.latest = Reported { reports: status.reports, tick, next_seq: self.acked };
        if self.seen != self.announced {
            // A report is missing: the device repeats it once it hears from the host.
            self.request_status();
        }
        emit(Event::Status { status, tick });
        if let Some(answer) = answered {
            emit(Event::Control(answer));
        }
        self.conclude(now, emit);
        Ok(())
    }

    /// Reads the reports that are next in order.
    fn read_reports(&mut self, now: HostInstant, emit: &mut dyn FnMut(Event)) -> Result<(), Contradiction> {
        loop {
            let number = self.seen.wrapping_add(1);
            let next = &mut self.early[usize::from(number) % REPORTS];
            let Some((_, report)) = next.take_if(|(found, _)| *found == number) else { break };
            self.report(now, number, report, emit)?;
        }
        // The next ping tells the device that they are read.
        self.request_status_within(SEEN_WITHIN);
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
        let stale = self.control.is_some() || self.stale.wrapping_sub(number) < u16::MAX / 2;
        let tick = self.read_report(now, &report, stale)?;
        self.known.report(&report, tick, self.clock_by(now));
        self.seen = number;
        if self.announced.wrapping_sub(number) > u16::MAX / 2 {
            self.announced = number;
        }
        match report {
            Report::Verdict { .. } | Report::OnsetRefused { .. } if stale => {
                let full = self.retired.verdicts.len() == REPORTS;
                let is_later = (1..=u16::MAX / 2).contains(&number.wrapping_sub(self.retired.after));
                if !full && is_later {
                    self.retired.verdicts.push_back(report);
                }
            }
            // The streamer learns of a mark when it has passed.
            Report::OnsetRefused { seq, .. } if self.is_item(seq) => {}
            Report::Verdict { .. } | Report::OnsetRefused { .. } => self.verdicts.push_back(report),
            Report::Onset { counters, .. } => emit(Event::Onset { tick, counters }),
            Report::Cut(cut) => emit(Event::Cut { cut, at: tick }),
            Report::Refused { motor, reason, .. } => emit(Event::StrokeRefused { motor, up: tick, reason }),
        }
        // `stale` follows the numbers: otherwise a number that has wrapped would count as before it.
        if self.stale.wrapping_sub(number) >= u16::MAX / 2 {
            self.stale = number;
        }
        Ok(())
    }

    /// Emits the verdicts of acknowledged frames, once all reports that the acknowledgement counts are read. Later reports
    /// may be missing: on a line that loses frames, one always is while the device refuses many strokes.
    fn conclude(&mut self, now: HostInstant, emit: &mut dyn FnMut(Event)) {
        self.conclude_retired(now, emit);
        let is_read = |mark: &Reported| self.seen.wrapping_sub(mark.reports) <= u16::MAX / 2;
        if is_read(&self.latest) {
            (self.concluded, self.waiting) = (self.latest, None);
        } else if let Some(read) = self.waiting.take_if(|waiting| is_read(waiting)) {
            self.concluded = read;
        }
        if !is_read(&self.latest) {
            self.waiting = self.waiting.or(Some(self.latest));
        }
        let Some(tick) = self.clock.tick_at(now) else { return };
        while let Some(batch) = self.window.front() {
            let decided = self.concluded.next_seq.wrapping_sub(batch.seq);
            if decided == 0 || decided > u16::MAX / 2 {
                break;
            }
            let Some(batch) = self.window.pop_front() else { break };
            let is_its = |report: &mut Report| match *report {
                Report::Verdict { seq, .. } | Report::OnsetRefused { seq, .. } => seq == batch.seq,
                _ => false,
            };
            let report = self.verdicts.pop_front_if(is_its);
            if let Some(Report::OnsetRefused { rendered, .. }) = report {
                emit(Event::OnsetRefused { rendered: rendered.near(tick) });
                continue;
            }
            if batch.is_onset() {
                self.kept = 0;
                emit(Event::OnsetAccepted);
            }
            if let Some(motors) = batch.withdraws {
                let kept = kept_motors(report);
                self.kept = (self.kept & !motors) | kept;
                emit(Event::Replaced { motors: motors & !kept, kept });
            }
            verdicts(&batch, report, self.kept, tick, now)
                .for_each(|(stroke, verdict)| emit(Event::Stroke(stroke, verdict)));
        }
    }

    /// Emits what is known of the strokes that had no verdict when a command ended their epoch.
    fn conclude_retired(&mut self, now: HostInstant, emit: &mut dyn FnMut(Event)) {
        let Some(tick) = self.clock.tick_at(now) else { return };
        while let Some(report) = self.retired.verdicts.pop_front() {
            let Report::Verdict { seq, .. } = report else { continue };
            let found = self.retired.frames.iter().position(|batch| batch.seq == seq);
            let Some(found) = found else { continue };
            // Frames before it without a report were taken as sent.
            for before in self.retired.frames.iter().take(found) {
                self.retired.kept &= !before.withdraws.unwrap_or(0);
            }
            let Some(batch) = self.retired.frames.remove(found) else { continue };
            self.retired.kept =
                (self.retired.kept & !batch.withdraws.unwrap_or(0)) | kept_motors(Some(report));
            let decided = verdicts(&batch, Some(report), self.retired.kept, tick, now);
            decided
                .filter(|(_, verdict)| *verdict != Verdict::Accepted)
                .for_each(|(stroke, verdict)| emit(Event::Stroke(stroke, verdict)));
        }
    }
}

/// The motors of which the device withdrew nothing, by its report if there is one.
fn kept_motors(report: Option<Report>) -> u32 {
    match report {
        Some(Report::Verdict { kept, .. }) => kept,
        _ => 0,
    }
}

/// The strokes of a frame with their verdicts, by the device's report if there is one. The device took no stroke of the motors
/// `kept`.
fn verdicts(
    batch: &Batch,
    report: Option<Report>,
    kept: u32,
    tick: Tick,
    now: HostInstant,
) -> impl Iterator<Item = (Stroke, Verdict)> {
    let (late, refused, why, free) = match report {
        Some(Report::Verdict { late, refused, reason, rendered, .. }) => {
            (late, refused, reason.unwrap_or(Refusal::Malformed), rendered.near(tick))
        }
        _ => (0, 0, Refusal::Malformed, tick),
    };
    let sent = batch.first_sent.unwrap_or(now);
    let strokes = Strokes::new(batch.strokes.base(), batch.strokes.bytes()).flatten();
    strokes.enumerate().map(move |(i, stroke)| {
        let verdict = if late >> i & 1 == 1 && kept >> stroke.motor & 1 == 1 {
            Verdict::Superseded
        } else if late >> i & 1 == 1 {
            Verdict::Late { rendered: free, sent, retransmitted: batch.retransmitted }
        } else if refused >> i & 1 == 1 {
            Verdict::Refused(why)
        } else {
            Verdict::Accepted
        };
        (stroke, verdict)
    })
}
