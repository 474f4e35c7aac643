//! What is due: commands first, then corrections, frames the device has not got, and pings.

use crate::link::session::{
    DEAF_FOR, DEAF_PINGS, DOUBT_EVERY, Event, FIRST_PING_EVERY, FIRST_PINGS, HELLO_EVERY, LostReason,
    MAX_HELLOS, Phase, Session,
};
use crate::time::HostInstant;
use firmware_protocol::batch::Packer;
use firmware_protocol::frame::{self, MAX_FRAME};
use firmware_protocol::message::HostMessage;
use firmware_protocol::tick::Tick;
use std::time::Duration;

impl Session {
    /// Writes the next frame that is due into `out` and returns its length; 0 when none is.
    pub fn transmit(
        &mut self,
        now: HostInstant,
        out: &mut [u8; MAX_FRAME],
        tell: &mut dyn FnMut(Event),
    ) -> usize {
        let len = match self.phase {
            Phase::Opening => self.next_hello(now, out, tell),
            Phase::Open => self.next_frame(now, out),
            Phase::Over => 0,
        };
        self.traffic.bytes_out += len as u64;
        len
    }

    fn next_hello(
        &mut self,
        now: HostInstant,
        out: &mut [u8; MAX_FRAME],
        tell: &mut dyn FnMut(Event),
    ) -> usize {
        if self.last_sent.is_some_and(|sent| now.since(sent) < HELLO_EVERY) {
            return 0;
        }
        if self.hellos == MAX_HELLOS {
            self.lose(LostReason::NoBoard, tell);
            return 0;
        }
        self.hellos += 1;
        self.last_sent = Some(now);
        // A zero first ends whatever half a frame the device has from before.
        out[0] = 0;
        1 + written(&HostMessage::Hello { session: self.id }, &mut out[1..])
    }

    fn next_frame(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> usize {
        let (epoch, seen, retry) = (self.epoch, self.seen, self.retry_after());
        if let Some(control) = &mut self.control
            && control.sent.is_none_or(|sent| now.since(sent) >= retry)
        {
            self.traffic.retransmitted += u64::from(control.sent.is_some());
            control.sent = Some(now);
            return written(&HostMessage::Control { epoch, seen, op: control.op }, out);
        }
        if self.amendments.items() > 0 && self.control.is_none() {
            self.generation = self.generation.wrapping_add(1);
            let (generation, base) = (self.generation, self.amendments.base().wire());
            let items = self.amendments.bytes();
            let len = written(&HostMessage::Amend { epoch, generation, base, items }, out);
            self.amendments = Packer::new(Tick(0));
            return len;
        }
        if let Some(len) = self.next_batch(now, out) {
            return len;
        }
        match self.next_survey(now, out) {
            0 => self.next_ping(now, out),
            len => len,
        }
    }

    /// The next frame of strokes that the device has not got: new, or sent in vain.
    fn next_batch(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> Option<usize> {
        if self.control.is_some() {
            return None;
        }
        let (epoch, seen, retry, acked) = (self.epoch, self.seen, self.retry_after(), self.acked);
        let mut on_the_way = 0;
        let mut next = None;
        for batch in &mut self.window {
            if batch.kept || is_before(batch.seq, acked) {
                continue;
            }
            if !batch.due && now.since(batch.last_sent) >= retry {
                (batch.due, batch.retransmitted) = (true, true);
            }
            if !batch.due {
                on_the_way += batch.len;
            } else if next.is_none() {
                next = Some(batch);
            }
        }
        let next = next?;
        // What is missing must not wait for what comes after it.
        if !next.retransmitted && on_the_way > 0 && on_the_way + MAX_FRAME > self.window_bytes {
            return None;
        }
        let (seq, onset, base) = (next.seq, next.onset, next.strokes.base().wire());
        let batch = next.strokes.bytes();
        let len = written(&HostMessage::Strokes { epoch, seq, seen, onset, base, batch }, out);
        self.traffic.retransmitted += u64::from(next.retransmitted);
        next.due = false;
        next.len = len;
        next.first_sent = next.first_sent.or(Some(now));
        next.last_sent = now;
        Some(len)
    }

    /// Gives the device up if it has not answered for too long.
    pub fn check_silence(&mut self, now: HostInstant, tell: &mut dyn FnMut(Event)) {
        let deaf = self.unanswered >= DEAF_PINGS && now.since(self.first_unanswered) >= DEAF_FOR;
        if self.phase == Phase::Open && deaf {
            self.lose(LostReason::NoAnswer, tell);
        }
    }

    fn next_ping(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> usize {
        if now < self.ping_due || self.is_surveying() {
            return 0;
        }
        self.ping(now, out)
    }

    pub(super) fn ping(&mut self, now: HostInstant, out: &mut [u8]) -> usize {
        if self.unanswered == 0 {
            self.first_unanswered = now;
        }
        self.unanswered += 1;
        let setting_clock = self.first_pings < FIRST_PINGS;
        let every = match self.unanswered {
            _ if setting_clock || !self.is_answered() => FIRST_PING_EVERY,
            1 => self.ping_every,
            _ => self.ping_every.min(DOUBT_EVERY),
        };
        self.ping_due = now + every;
        self.token = self.token.wrapping_add(1).max(1);
        self.pinged[usize::from(self.token) % self.pinged.len()] = (self.token, now);
        self.last_ping = now;
        written(&HostMessage::Ping { token: self.token, seen: self.seen }, out)
    }

    /// When [`Self::transmit`] may have something next, if nothing happens before.
    #[must_use]
    pub fn wake_at(&self, now: HostInstant) -> HostInstant {
        let retry = self.retry_after();
        match self.phase {
            Phase::Opening => self.last_sent.map_or(now, |sent| sent + HELLO_EVERY),
            Phase::Over => now + Duration::from_secs(1),
            Phase::Open => {
                let control = self.control.as_ref().map(|c| c.sent.map_or(now, |sent| sent + retry));
                let mut missing =
                    self.window.iter().filter(|batch| !batch.kept && !is_before(batch.seq, self.acked));
                let frames = missing.next().map(|batch| match batch.first_sent {
                    Some(_) => batch.last_sent + retry,
                    None => now,
                });
                // While the probe's ping is on its way, no other is sent.
                let ping = if self.is_surveying() { None } else { Some(self.ping_due) };
                let due = [control, frames, ping, self.survey_at(now)];
                due.into_iter().flatten().min().unwrap_or(now)
            }
        }
    }
}

/// Whether `a` comes before `b`, as numbers that wrap.
fn is_before(a: u16, b: u16) -> bool {
    a.wrapping_sub(b) > u16::MAX / 2
}

pub(super) fn written(message: &HostMessage<'_>, out: &mut [u8]) -> usize {
    // Every message fits a frame: batches are bounded by `BATCH_BYTES`.
    frame::encode(message, out).unwrap_or(0)
}
