//! Writes what is due: commands first, then corrections, frames the device misses, the link probe's, and pings.
//!
//! The parts say what is due and when; here is their order. Invariant: while a command waits for its answer, no strokes, amendments
//! or requests leave.

use crate::link::session::batch::{Head, encoded};
use crate::link::session::contradiction::Contradiction;
use crate::link::session::event::{Event, LostReason};
use crate::link::session::probe::{self, Step};
use crate::link::session::repetition::Turn;
use crate::link::session::{Phase, Session};
use crate::time::HostInstant;
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::{HostMessage, Op};
use firmware_protocol::tick::Tick;
use std::time::Duration;

/// Most hellos without an answer.
const MAX_HELLOS: u16 = 40;
/// A device that answers pings also answers commands and sends the reports that it announces: every 10 ms until it was heard.
const WITHHELD_FOR: Duration = Duration::from_secs(3);

impl Session {
    /// Writes the next frame that is due into `out` and returns its length; 0 when none is.
    pub fn transmit(
        &mut self,
        now: HostInstant,
        out: &mut [u8; MAX_FRAME],
        emit: &mut dyn FnMut(Event),
    ) -> usize {
        let len = match self.phase {
            Phase::Opening => self.next_hello(now, out, emit),
            Phase::Open => self.next_frame(now, out),
            Phase::Closing(how) => self.next_e_stop(now, how, out, emit),
            Phase::Over => 0,
        };
        if len > 0 {
            self.wire.sent(len);
            self.line.quality.sent(len);
        }
        len
    }

    fn next_hello(&mut self, now: HostInstant, out: &mut [u8], emit: &mut dyn FnMut(Event)) -> usize {
        // A device that is heard, if damaged, deserves more tries.
        let most = if self.wire.is_noisy() { 4 * MAX_HELLOS } else { MAX_HELLOS };
        match self.hellos.next(now, most) {
            Turn::Wait => 0,
            Turn::Send(_) => {
                // The leading zero ends a frame that an earlier session may have left half sent.
                out[0] = 0;
                1 + encoded(&HostMessage::Hello { session: self.id }, &mut out[1..])
            }
            Turn::Spent => {
                self.lose(self.wire.silence(LostReason::NoBoard), emit);
                0
            }
        }
    }

    /// The last frames to a device that is not trusted.
    fn next_e_stop(
        &mut self,
        now: HostInstant,
        how: Contradiction,
        out: &mut [u8],
        emit: &mut dyn FnMut(Event),
    ) -> usize {
        match self.commands.next_last(now) {
            Turn::Wait => 0,
            Turn::Send(epoch) => {
                encoded(&HostMessage::Control { epoch, seen: self.reports.seen(), op: Op::EStop }, out)
            }
            Turn::Spent => {
                self.lose(LostReason::Contradicts(how), emit);
                0
            }
        }
    }

    fn next_frame(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> usize {
        let (epoch, seen, retry) = (self.commands.epoch(), self.reports.seen(), self.retry_after());
        if let Some((op, again)) = self.commands.next(now, retry) {
            self.wire.repeated(again);
            return encoded(&HostMessage::Control { epoch, seen, op }, out);
        }
        if !self.commands.is_waiting() {
            if let Some((generation, packed)) = self.outbox.next_amendments() {
                let (base, items) = (packed.base().wire(), packed.bytes());
                return encoded(&HostMessage::Amend { epoch, generation, base, items }, out);
            }
            let window_bytes = self.line.window_bytes;
            if let Some(written) = self.outbox.write_next(now, Head { epoch, seen }, retry, window_bytes, out)
            {
                self.wire.repeated(written.retransmitted);
                written.marks.into_iter().for_each(|onset| self.known.mark_sent(onset));
                return written.len;
            }
        }
        if self.may_ask()
            && let Some(question) = self.asking.next(now, retry)
        {
            return encoded(&question, out);
        }
        match self.next_probe(now, out) {
            0 if now >= self.pinger.due() && !self.line.probe.is_busy() => self.ping(now, out).1,
            len => len,
        }
    }

    /// The link probe's next frame; 0 when there is none.
    fn next_probe(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> usize {
        let quiet = self.pinger.is_quiet(now)
            && self.is_open()
            && !self.commands.is_waiting()
            && self.outbox.is_empty();
        match self.line.next_step(now, quiet) {
            Step::Filler => {
                let len = self.filler(out);
                self.line.probe.sent_filler(len);
                len
            }
            Step::Ping => {
                let (token, len) = self.ping(now, out);
                self.line.probe.sent_ping(now, len, token);
                len
            }
            Step::Nothing => 0,
        }
    }

    /// A full frame of strokes of an epoch before the session's own: the device acknowledges and ignores it.
    fn filler(&self, out: &mut [u8; MAX_FRAME]) -> usize {
        let (epoch, seen, strokes) = (self.commands.past_epoch(), self.reports.seen(), probe::filler());
        let (base, batch) = (Tick(0).wire(), strokes.bytes());
        encoded(&HostMessage::Moves { epoch, seq: 0, seen, mark: None, withdraw: None, base, batch }, out)
    }

    /// Writes a ping; returns its token and its length.
    fn ping(&mut self, now: HostInstant, out: &mut [u8]) -> (u16, usize) {
        let token = self.pinger.ping(now, !self.is_answered(), self.wire.is_disturbed());
        (token, encoded(&HostMessage::Ping { token, seen: self.reports.seen() }, out))
    }

    /// Ends the session if the device has not answered for too long, or withholds an answer or a report.
    pub fn check_silence(&mut self, now: HostInstant, emit: &mut dyn FnMut(Event)) {
        self.line.awake(now);
        let withheld =
            |since: Option<HostInstant>| since.is_some_and(|since| now.since(since) >= WITHHELD_FOR);
        if withheld(self.reports.missing_since(now)) {
            self.distrust(Contradiction::Reports, emit);
        } else if withheld(self.commands.waiting_since()) {
            self.distrust(Contradiction::Command, emit);
        }
        if self.phase == Phase::Open && self.pinger.is_silent(now, self.wire.is_disturbed()) {
            self.lose(self.wire.silence(LostReason::NoAnswer), emit);
        }
    }

    /// When [`Self::transmit`] may have something next, if nothing happens before.
    pub fn wake_at(&self, now: HostInstant) -> HostInstant {
        let retry = self.retry_after();
        match self.phase {
            Phase::Opening => self.hellos.due(now),
            Phase::Closing(_) => self.commands.last_due(now),
            Phase::Over => now + Duration::from_secs(1),
            Phase::Open => {
                let due = [
                    self.commands.due(now, retry),
                    self.outbox.due(now, retry),
                    // While the probe's ping is under way, the session sends no other.
                    (!self.line.probe.is_busy()).then(|| self.pinger.due()),
                    self.may_ask().then(|| self.asking.due(now, retry)),
                    self.line.probe.due(now, self.is_open().then(|| self.pinger.quiet_by())),
                ];
                due.into_iter().flatten().min().unwrap_or(now)
            }
        }
    }

    /// Whether the line is free for requests: the probe is over, and no command waits for its answer.
    fn may_ask(&self) -> bool {
        self.is_open() && self.line.probe.is_over() && !self.commands.is_waiting()
    }

    /// How long the session waits for an acknowledgement before it sends again.
    fn retry_after(&self) -> Duration {
        self.line.retry_after(self.pinger.round_trip())
    }
}
