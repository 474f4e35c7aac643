//! What the line carries: measured once, after the handshake and before the first arm.
//!
//! A few rounds of frames that the device acknowledges and ignores, full frames of an older epoch, each ended by a
//! ping: from the first byte to the ping's answer, less an idle round trip, is what the frames took. A round is as
//! long as the session lets bytes be on their way, so an e-stop never waits for more than that. What a round took
//! longer than its bytes is what an acknowledgement is waited for.
//!
//! Bounds: [`Budget`] in bytes and time, [`ROUNDS`] rounds, one at a time.
//! Invariant: when it is over, [`Session::is_probed`] says so for good, whether or not anything was measured.

use crate::link::session::{LineRate, Session};
use crate::time::HostInstant;
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::HostMessage;
use firmware_protocol::stroke::Stroke;
use firmware_protocol::tick::Tick;
use std::time::Duration;

/// Rounds at the most.
const ROUNDS: usize = 32;
/// A round without an answer for so long is given up; its ping may have been lost.
const ROUND_WITHIN: Duration = Duration::from_millis(250);
/// Pings still on their way would be measured with the first round: they are waited for, but not longer.
const QUIET_WITHIN: Duration = Duration::from_millis(100);

/// What a probe may cost, in bytes sent and from its first byte on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Bytes sent, at the most.
    pub bytes: usize,
    /// After this no round is begun.
    pub time: Duration,
}

impl Default for Budget {
    /// Ten milliseconds of USB; a dozen rounds at 115 200 baud.
    fn default() -> Self {
        Self { bytes: 8000, time: Duration::from_millis(300) }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Waits for the line to be quiet.
    Waiting,
    /// So many bytes of the round are still to be sent.
    Sending(usize),
    /// The round's ping was sent at this instant.
    Sent(HostInstant),
    Over,
}

/// A probe under way, or its result.
#[derive(Debug)]
pub(super) struct Probe {
    stage: Stage,
    budget: Budget,
    begun: HostInstant,
    /// When the round began, its bytes, and its ping with its own.
    round: (HostInstant, usize, u16),
    ping: usize,
    spent: usize,
    /// Each round's bytes per second, its bytes and how long it took with its answer.
    rates: [u32; ROUNDS],
    took: [(usize, Duration); ROUNDS],
    rounds: usize,
}

impl Probe {
    pub(super) fn new(budget: Budget) -> Self {
        let round = (HostInstant::default(), 0, 0);
        let stage = Stage::Waiting;
        let (begun, took) = (HostInstant::default(), [(0, Duration::ZERO); ROUNDS]);
        Self { stage, budget, begun, round, ping: 0, spent: 0, rates: [0; ROUNDS], took, rounds: 0 }
    }

    /// The upper quartile of the rounds: stalls of either side make them too slow, and nothing makes them too fast but
    /// an idle round trip that was itself held up.
    fn rate(&self) -> Option<LineRate> {
        let mut rates = self.rates;
        let rates = &mut rates[..self.rounds];
        rates.sort_unstable();
        rates.get(rates.len() * 3 / 4).copied().map(LineRate)
    }

    /// How long an acknowledgement is waited for on a line of this rate: the upper quartile again. The shortest round
    /// trip is not what a play gets on a link that jitters; the longest are stalls, for which there is the lead.
    fn wait(&self, line: LineRate) -> Duration {
        let mut waits = self.took.map(|(bytes, took)| took.saturating_sub(line.time(bytes)));
        let waits = &mut waits[..self.rounds];
        waits.sort_unstable();
        waits.get(waits.len() * 3 / 4).copied().unwrap_or_default()
    }
}

impl Session {
    /// Whether the probe is over; before, [`Self::line`] is not known.
    #[must_use]
    pub fn is_probed(&self) -> bool {
        self.probe.stage == Stage::Over
    }

    /// What the line was measured to carry while nothing waits for an answer, its nominal rate at the most.
    #[must_use]
    pub fn line(&self) -> Option<LineRate> {
        self.line.map(|(line, _)| line)
    }

    /// Bytes per second of full frames that the device acknowledges: [`Self::line`], less the waiting for
    /// acknowledgements when few bytes may be on their way. `None` until it is measured.
    #[must_use]
    pub fn capacity(&self) -> Option<u32> {
        let (line, wait) = self.line?;
        let on_the_way = (self.frames_on_the_way() * MAX_FRAME) as f64;
        let waiting = on_the_way / (wait + line.time(MAX_FRAME)).as_secs_f64();
        Some(waiting.min(line.0.into()) as u32)
    }

    /// Bytes per second that are left of [`Self::line`] when so many frames a second, however short, wait for their
    /// acknowledgements. `None` until it is measured.
    #[must_use]
    pub fn rate_left(&self, frames_per_s: u32) -> Option<u32> {
        let waiting = f64::from(frames_per_s) * self.ack_wait()?.as_secs_f64();
        Some((f64::from(self.line()?.0) * (1.0 - waiting)) as u32)
    }

    /// How long a frame waits, besides its bytes, for those before it to be acknowledged.
    #[must_use]
    pub fn ack_wait(&self) -> Option<Duration> {
        let (_, wait) = self.line?;
        Some(wait / self.frames_on_the_way() as u32)
    }

    /// Whole frames that may be on their way at once.
    fn frames_on_the_way(&self) -> usize {
        self.window_bytes / MAX_FRAME
    }

    /// Surveys the line again, with this budget: for whoever wants to know it better. Not while anything is played.
    pub fn probe(&mut self, budget: Budget) {
        self.probe = Probe::new(budget);
    }

    /// Whether the probe has a ping on its way, beside which no other may be sent: the device answers the last one.
    pub(super) fn is_surveying(&self) -> bool {
        matches!(self.probe.stage, Stage::Sending(_) | Stage::Sent(_))
    }

    /// When the probe has something to do, if no answer comes before.
    pub(super) fn survey_at(&self, now: HostInstant) -> Option<HostInstant> {
        match self.probe.stage {
            Stage::Waiting if self.is_open() => Some(self.last_ping + QUIET_WITHIN),
            Stage::Sending(_) => Some(now),
            Stage::Sent(at) => Some(at + ROUND_WITHIN),
            Stage::Waiting | Stage::Over => None,
        }
    }

    /// The probe's next frame; 0 when there is none.
    pub(super) fn next_survey(&mut self, now: HostInstant, out: &mut [u8]) -> usize {
        match self.probe.stage {
            Stage::Waiting => {
                let quiet = self.answered == self.token || now.since(self.last_ping) >= QUIET_WITHIN;
                if !self.is_open() || !quiet || self.control.is_some() || !self.window.is_empty() {
                    return 0;
                }
                self.probe.begun = now;
                self.begin_round(now, MAX_FRAME);
                self.next_survey(now, out)
            }
            Stage::Sending(0) => {
                let len = self.ping(now, out);
                self.probe.stage = Stage::Sent(now);
                self.probe.ping = len;
                self.probe.round.2 = self.token;
                self.probe.spent += len;
                len
            }
            Stage::Sending(left) => {
                let len = self.filler(out);
                self.probe.round.1 += len;
                self.probe.spent += len;
                // A frame more would be more than may be on its way.
                let left = left.saturating_sub(MAX_FRAME);
                self.probe.stage = Stage::Sending(if left < MAX_FRAME { 0 } else { left });
                len
            }
            Stage::Sent(at) => {
                if now.since(at) >= ROUND_WITHIN {
                    self.next_round(now);
                }
                0
            }
            Stage::Over => 0,
        }
    }

    /// A status that answers the probe's ping: `true` if it was one.
    pub(super) fn probed(&mut self, now: HostInstant, token: u16) -> bool {
        let (begun, bytes, ping) = self.probe.round;
        if token != ping || !matches!(self.probe.stage, Stage::Sent(_)) {
            return false;
        }
        self.probe.took[self.probe.rounds] = (bytes + self.probe.ping, now.since(begun));
        // An idle round trip has its ping's bytes in it.
        let took = now.since(begun).saturating_sub(self.fastest).as_secs_f64();
        // Faster than can be told: then it is the nominal rate.
        let rate = if took > 1e-6 { bytes as f64 / took } else { f64::from(u32::MAX) };
        self.probe.rates[self.probe.rounds] = (rate as u32).max(1);
        self.probe.rounds += 1;
        self.next_round(now);
        true
    }

    fn begin_round(&mut self, now: HostInstant, bytes: usize) {
        self.probe.round = (now, 0, 0);
        self.probe.stage = Stage::Sending(bytes.max(MAX_FRAME));
    }

    fn next_round(&mut self, now: HostInstant) {
        let Probe { budget, begun, spent, rounds, .. } = self.probe;
        let nominal = self.nominal;
        let bound = |rate: LineRate| LineRate(rate.0.min(nominal.0));
        let bytes = self.probe.rate().map_or(MAX_FRAME, |rate| bound(rate).window_bytes());
        if rounds < ROUNDS && spent + bytes <= budget.bytes && now.since(begun) < budget.time {
            self.begin_round(now, bytes);
            return;
        }
        self.probe.stage = Stage::Over;
        self.line = self.probe.rate().map(bound).map(|rate| (rate, self.probe.wait(rate)));
        self.window_bytes = self.line().unwrap_or(nominal).window_bytes();
    }

    /// A full frame of strokes of the epoch before the session's own: acknowledged and ignored.
    fn filler(&self, out: &mut [u8]) -> usize {
        let mut strokes = Packer::<BATCH_BYTES>::new(Tick(0));
        let (mut up, mut pulses) = (Tick(0), 147);
        // No count like the one before it: as many strokes as a frame may have fill it.
        while strokes
            .stroke(&Stroke { motor: 0, up, up_pulses: pulses, down: up + 708, down_pulses: pulses })
            .is_ok()
        {
            (up, pulses) = (up + 1417, pulses ^ 1);
        }
        let epoch = self.greeted.wrapping_sub(1);
        let message = HostMessage::Strokes {
            epoch,
            seq: 0,
            seen: self.seen,
            onset: false,
            base: Tick(0).wire(),
            batch: strokes.bytes(),
        };
        super::outbound::written(&message, out)
    }
}
