//! Writes what is due: commands first, then corrections, frames the device misses, the link probe's, and pings.

use crate::link::session::contradiction::Contradiction;
use crate::link::session::event::{Event, LostReason};
use crate::link::session::probe::{QUIET_TIMEOUT, Step};
use crate::link::session::state::{FIRST_PINGS, Phase, Session};
use crate::time::HostInstant;
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::frame::{self, MAX_FRAME};
use firmware_protocol::message::{HostMessage, Op, Withdraw};
use firmware_protocol::stroke::Stroke;
use firmware_protocol::tick::Tick;
use std::time::Duration;

/// Interval of the first pings.
const FIRST_PING_EVERY: Duration = Duration::from_millis(2);
/// The device counts as lost when it leaves so many pings in a row unanswered, over so long a time.
const MAX_UNANSWERED: u32 = 5;
const UNANSWERED_FOR: Duration = Duration::from_millis(400);
/// Once a ping is unanswered, the session pings this often.
const RECHECK_EVERY: Duration = Duration::from_millis(100);
/// The same while the line damages the answers; and so many damaged frames in a row make a line noisy.
const NOISY_EVERY: Duration = Duration::from_millis(10);
const MAX_UNANSWERED_NOISY: u32 = 40;
const NOISE: u32 = 5;
/// Interval and largest number of hellos without an answer.
const HELLO_EVERY: Duration = Duration::from_millis(50);
const MAX_HELLOS: u32 = 40;
/// E-stops to a device that is not trusted: a tenth of a second in all.
const E_STOPS: u16 = 20;
const E_STOP_EVERY: Duration = Duration::from_millis(5);
/// Each e-stop begins an epoch a third of their range from the last, so one of three is newer, whatever the device's epoch is.
const E_STOP_EPOCHS: u16 = 0x5555;
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
        self.traffic.bytes_out += len as u64;
        if len > 0 {
            self.quality.sent(len);
        }
        len
    }

    /// Why a device that does not answer counts as lost.
    fn silent(&self, otherwise: LostReason) -> LostReason {
        if self.noise < NOISE {
            otherwise
        } else {
            LostReason::Noisy { percent: self.traffic.damaged_percent() as u8 }
        }
    }

    fn next_hello(
        &mut self,
        now: HostInstant,
        out: &mut [u8; MAX_FRAME],
        emit: &mut dyn FnMut(Event),
    ) -> usize {
        if self.last_sent.is_some_and(|sent| now.since(sent) < HELLO_EVERY) {
            return 0;
        }
        // A device that is heard, if damaged, deserves more tries.
        let most = if self.noise < NOISE { MAX_HELLOS } else { 4 * MAX_HELLOS };
        if self.hellos >= most {
            self.lose(self.silent(LostReason::NoBoard), emit);
            return 0;
        }
        self.hellos += 1;
        self.last_sent = Some(now);
        self.first_hello.get_or_insert(now);
        // The leading zero ends a frame that an earlier session may have left half sent.
        out[0] = 0;
        1 + encoded(&HostMessage::Hello { session: self.id }, &mut out[1..])
    }

    /// The epoch of the e-stop of this number, from 1, to a device that is not trusted.
    pub(super) fn last_epoch(&self, number: u16) -> u16 {
        self.epoch.wrapping_add(1).wrapping_add(number.wrapping_mul(E_STOP_EPOCHS))
    }

    /// The last frames to a device that is not trusted.
    fn next_e_stop(
        &mut self,
        now: HostInstant,
        how: Contradiction,
        out: &mut [u8; MAX_FRAME],
        emit: &mut dyn FnMut(Event),
    ) -> usize {
        if self.last_sent.is_some_and(|sent| now.since(sent) < E_STOP_EVERY) {
            return 0;
        }
        if self.e_stops == E_STOPS {
            self.lose(LostReason::Contradicts(how), emit);
            return 0;
        }
        self.e_stops += 1;
        self.last_sent = Some(now);
        self.distrusted_at = self.distrusted_at.or(Some(now));
        let epoch = self.last_epoch(self.e_stops);
        if self.e_stops > 1 {
            self.new_e_stop = Some(epoch);
        }
        encoded(&HostMessage::Control { epoch, seen: self.seen, op: Op::EStop }, out)
    }

    fn next_frame(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> usize {
        let (epoch, seen, retry) = (self.epoch, self.seen, self.retry_after());
        if let Some(control) = &mut self.control
            && control.sent.is_none_or(|sent| now.since(sent) >= retry)
        {
            self.traffic.retransmitted += u64::from(control.sent.is_some());
            control.first_sent.get_or_insert(now);
            (control.sent, control.under_way) = (Some(now), true);
            return encoded(&HostMessage::Control { epoch, seen, op: control.op }, out);
        }
        if self.amendments.items() > 0 && self.control.is_none() {
            self.generation = self.generation.wrapping_add(1);
            let (generation, base) = (self.generation, self.amendments.base().wire());
            let items = self.amendments.bytes();
            let len = encoded(&HostMessage::Amend { epoch, generation, base, items }, out);
            self.amendments = Packer::new(Tick(0));
            return len;
        }
        if let Some(len) = self.next_batch(now, out) {
            return len;
        }
        if let Some(question) = self.next_question(now) {
            return encoded(&question, out);
        }
        match self.next_probe(now, out) {
            0 => self.next_ping(now, out),
            len => len,
        }
    }

    /// The next frame of strokes that the device misses: new, or lost on the way.
    fn next_batch(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> Option<usize> {
        if self.control.is_some() {
            return None;
        }
        let (epoch, seen, retry, acked) = (self.epoch, self.seen, self.retry_after(), self.acked);
        let mut unacknowledged = 0;
        let mut next = None;
        for batch in &mut self.window {
            if batch.kept || is_before(batch.seq, acked) {
                continue;
            }
            if !batch.due && now.since(batch.last_sent) >= retry {
                (batch.due, batch.retransmitted) = (true, true);
            }
            if !batch.due {
                unacknowledged += batch.len;
            } else if next.is_none() {
                next = Some(batch);
            }
        }
        let next = next?;
        // A missing frame must not wait for the frames after it.
        if !next.retransmitted && unacknowledged > 0 && unacknowledged + MAX_FRAME > self.window_bytes {
            return None;
        }
        let (seq, mark, base) = (next.seq, next.mark, next.strokes.base().wire());
        // No amendment of a stroke of this frame is sent before its verdict, so the amendments up to now concern old strokes.
        let withdraw = next.withdraws.map(|motors| Withdraw { motors, generation: self.generation });
        let batch = next.strokes.bytes();
        let len = encoded(&HostMessage::Strokes { epoch, seq, seen, mark, withdraw, base, batch }, out);
        self.traffic.retransmitted += u64::from(next.retransmitted);
        next.due = false;
        next.len = len;
        let first = next.first_sent.is_none();
        next.first_sent = next.first_sent.or(Some(now));
        next.last_sent = now;
        if first && mark.is_some() {
            self.known.mark_sent(next.strokes.base());
        }
        Some(len)
    }

    /// The link probe's next frame; 0 when there is none.
    fn next_probe(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> usize {
        let quiet = self.answered == self.token || now.since(self.last_ping) >= QUIET_TIMEOUT;
        let quiet = quiet && self.is_open() && self.control.is_none() && self.window.is_empty();
        let was_over = self.probe.is_over();
        match self.probe.next(now, quiet) {
            Step::Filler => {
                let len = self.filler(out);
                self.probe.sent_filler(len);
                len
            }
            Step::Ping => {
                let len = self.ping(now, out);
                self.probe.sent_ping(now, len, self.token);
                len
            }
            Step::Nothing => {
                if !was_over {
                    self.adopt_probe();
                }
                0
            }
        }
    }

    /// A full frame of strokes of the epoch before the session's own: the device acknowledges and ignores it.
    fn filler(&self, out: &mut [u8; MAX_FRAME]) -> usize {
        let mut strokes = Packer::<BATCH_BYTES>::new(Tick(0));
        let (mut up, mut pulses) = (Tick(0), 147);
        // Neighbouring counts differ, so that the packer cannot shorten them: the frame is full.
        while strokes
            .stroke(&Stroke { motor: 0, up, up_pulses: pulses, down: up + 708, down_pulses: pulses })
            .is_ok()
        {
            (up, pulses) = (up + 1417, pulses ^ 1);
        }
        let (epoch, batch) = (self.first_epoch.wrapping_sub(1), strokes.bytes());
        let base = Tick(0).wire();
        encoded(
            &HostMessage::Strokes { epoch, seq: 0, seen: self.seen, mark: None, withdraw: None, base, batch },
            out,
        )
    }

    /// Ends the session if the device has not answered for too long, or withholds an answer or a report.
    pub fn check_silence(&mut self, now: HostInstant, emit: &mut dyn FnMut(Event)) {
        let missing = self.missing.filter(|&(seen, _)| seen == self.seen).or(Some((self.seen, now)));
        self.missing = missing.filter(|_| self.seen != self.announced);
        let withheld =
            |since: Option<HostInstant>| since.is_some_and(|since| now.since(since) >= WITHHELD_FOR);
        if withheld(self.missing.map(|(_, since)| since)) {
            self.distrust(Contradiction::Reports, emit);
        } else if withheld(self.control.as_ref().and_then(|control| control.first_sent)) {
            self.distrust(Contradiction::Command, emit);
        }
        let most = if self.noise == 0 { MAX_UNANSWERED } else { MAX_UNANSWERED_NOISY };
        let silent = self.unanswered >= most && now.since(self.first_unanswered) >= UNANSWERED_FOR;
        if self.phase == Phase::Open && silent {
            self.lose(self.silent(LostReason::NoAnswer), emit);
        }
    }

    fn next_ping(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> usize {
        if now < self.ping_due || self.probe.is_busy() {
            return 0;
        }
        self.ping(now, out)
    }

    fn ping(&mut self, now: HostInstant, out: &mut [u8]) -> usize {
        if self.unanswered == 0 {
            self.first_unanswered = now;
        }
        self.unanswered += 1;
        let setting_clock = self.first_pings < FIRST_PINGS;
        let every = match self.unanswered {
            _ if setting_clock || !self.is_answered() => FIRST_PING_EVERY,
            _ if self.noise > 0 => NOISY_EVERY,
            1 => self.ping_every,
            _ => self.ping_every.min(RECHECK_EVERY),
        };
        self.ping_due = now + every;
        self.token = self.token.wrapping_add(1).max(1);
        self.pinged[usize::from(self.token) % self.pinged.len()] = (self.token, now);
        self.last_ping = now;
        encoded(&HostMessage::Ping { token: self.token, seen: self.seen }, out)
    }

    /// When [`Self::transmit`] may have something next, if nothing happens before.
    #[must_use]
    pub fn wake_at(&self, now: HostInstant) -> HostInstant {
        let retry = self.retry_after();
        match self.phase {
            Phase::Opening => self.last_sent.map_or(now, |sent| sent + HELLO_EVERY),
            Phase::Closing(_) => self.last_sent.map_or(now, |sent| sent + E_STOP_EVERY),
            Phase::Over => now + Duration::from_secs(1),
            Phase::Open => {
                let control = self.control.as_ref().map(|c| c.sent.map_or(now, |sent| sent + retry));
                let mut missing =
                    self.window.iter().filter(|batch| !batch.kept && !is_before(batch.seq, self.acked));
                let frames = missing.next().map(|batch| match batch.first_sent {
                    Some(_) => batch.last_sent + retry,
                    None => now,
                });
                // While the probe's ping is under way, the session sends no other.
                let ping = if self.probe.is_busy() { None } else { Some(self.ping_due) };
                let due = [
                    control,
                    frames,
                    ping,
                    self.question_due(now),
                    self.probe.due(now, self.is_open().then(|| self.last_ping + QUIET_TIMEOUT)),
                ];
                due.into_iter().flatten().min().unwrap_or(now)
            }
        }
    }
}

/// Whether `a` comes before `b`; both wrap.
fn is_before(a: u16, b: u16) -> bool {
    a.wrapping_sub(b) > u16::MAX / 2
}

fn encoded(message: &HostMessage<'_>, out: &mut [u8]) -> usize {
    // Every message fits a frame: batches are bounded by `BATCH_BYTES`.
    frame::encode(message, out).unwrap_or(0)
}
