//! The link probe: measures once, after the handshake and before the first arm, what the line carries.
//!
//! It sends a few rounds of full frames of an older epoch, which the device acknowledges and ignores; a ping ends each round. The
//! time from the first byte to the ping's answer, less an idle round trip, is what the frames took. A round is as long as the
//! bytes the session may have unacknowledged, so an e-stop never waits for more than that. The time that a round takes beyond the
//! time of its bytes is the time of an acknowledgement.
//!
//! A round in which the host stood still says nothing about the line, so it does not count: while a round is under way the session
//! wakes up every [`LOOK_EVERY`], and notices when it was late.
//!
//! The session asks [`Probe::next`] what to send, sends it, and reports what it sent and heard.
//! Bounds: [`Budget`] in bytes and time after the first [`LEAST_ROUNDS`] rounds, [`ROUNDS`] rounds, one at a time.
//! Invariant: a probe that ended stays over, whether or not it measured anything.

use crate::link::session::rate::{LineRate, MeasuredLine};
use crate::time::HostInstant;
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Stroke;
use std::time::Duration;

/// Rounds at most.
const ROUNDS: usize = 32;
/// Rounds at least, answered or not: a host that stalls in the first must not leave it as the only one.
const LEAST_ROUNDS: usize = 3;
/// The probe gives a round up after this time: the device may have lost its ping, or the host stood still. No line that
/// carries a play is so slow.
const ROUND_TIMEOUT: Duration = Duration::from_millis(250);

/// How often the session wakes up during a round, and how much later than the last time the host has stood still. A line on which
/// rounds are held up for less carries a play.
const LOOK_EVERY: Duration = Duration::from_micros(500);
const STOOD_STILL: Duration = Duration::from_millis(2);

/// What a probe may cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Bytes sent, at most.
    pub bytes: usize,
    /// From the first byte on; after it the probe begins no round, except the first three.
    pub time: Duration,
}

impl Default for Budget {
    /// Ten milliseconds of USB; a dozen rounds at 115 200 baud.
    fn default() -> Self {
        Self { bytes: 8000, time: Duration::from_millis(300) }
    }
}

/// What the session sends next for the probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub(super) enum Step {
    Nothing,
    /// A full frame that the device ignores.
    Filler,
    Ping,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Waits for the line to be quiet.
    Waiting,
    /// So many bytes of the round are still to be sent.
    Sending(usize),
    /// The round's ping left at this instant.
    Sent(HostInstant),
    Over,
}

/// The round under way.
#[derive(Clone, Debug, Default)]
struct Round {
    began: HostInstant,
    /// Bytes of its frames, and of its ping.
    bytes: usize,
    ping_bytes: usize,
    /// Its ping's token.
    token: u16,
    /// When the session was last awake, and whether the host has stood still.
    awake: HostInstant,
    held_up: bool,
}

/// A probe under way, or its result.
#[derive(Clone, Debug)]
pub(super) struct Probe {
    stage: Stage,
    budget: Budget,
    /// The line's rate as its transport knows it: no result is above it.
    nominal: LineRate,
    began: HostInstant,
    round: Round,
    spent: usize,
    /// For each round: bytes per second; its bytes and how long it took with its answer.
    rates: [u32; ROUNDS],
    took: [(usize, Duration); ROUNDS],
    rounds: usize,
    /// Rounds begun, answered or not.
    begun: usize,
}

/// The strokes of a full frame, from tick 0 on.
pub(super) fn filler() -> Packer<BATCH_BYTES> {
    let mut strokes = Packer::new(Tick(0));
    let (mut up, mut pulses) = (Tick(0), 147);
    // Neighbouring counts differ, so that the packer cannot shorten them: the frame is full.
    while (Stroke { motor: 0, up, up_pulses: pulses, down: up + 708, down_pulses: pulses })
        .pack(&mut strokes)
        .is_ok()
    {
        (up, pulses) = (up + 1417, pulses ^ 1);
    }
    strokes
}

impl Probe {
    pub(super) fn new(budget: Budget, nominal: LineRate) -> Self {
        Self {
            stage: Stage::Waiting,
            budget,
            nominal,
            began: HostInstant::default(),
            round: Round::default(),
            spent: 0,
            rates: [0; ROUNDS],
            took: [(0, Duration::ZERO); ROUNDS],
            rounds: 0,
            begun: 0,
        }
    }

    pub(super) fn is_over(&self) -> bool {
        self.stage == Stage::Over
    }

    /// Whether a round is under way. The session then sends no ping of its own: the device answers only the last one.
    pub(super) fn is_busy(&self) -> bool {
        matches!(self.stage, Stage::Sending(_) | Stage::Sent(_))
    }

    /// When the probe has something to do, if no answer comes before. `quiet_by`: when an open line counts as quiet.
    pub(super) fn due(&self, now: HostInstant, quiet_by: Option<HostInstant>) -> Option<HostInstant> {
        match self.stage {
            Stage::Waiting => quiet_by,
            Stage::Sending(_) => Some(now),
            Stage::Sent(at) => Some((at + ROUND_TIMEOUT).min(self.round.awake + LOOK_EVERY)),
            Stage::Over => None,
        }
    }

    /// What to send now; `quiet` if the line is open and nothing else is under way on it.
    pub(super) fn next(&mut self, now: HostInstant, quiet: bool) -> Step {
        match self.stage {
            Stage::Waiting if quiet => {
                self.began = now;
                self.begin_round(now, MAX_FRAME);
                Step::Filler
            }
            Stage::Sending(0) => Step::Ping,
            Stage::Sending(_) => Step::Filler,
            Stage::Sent(at) => {
                if now.since(at) >= ROUND_TIMEOUT {
                    self.next_round(now);
                }
                Step::Nothing
            }
            Stage::Waiting | Stage::Over => Step::Nothing,
        }
    }

    /// The session is awake.
    pub(super) fn awake(&mut self, now: HostInstant) {
        self.round.held_up |= now.since(self.round.awake) > STOOD_STILL;
        self.round.awake = now;
    }

    /// The session sent a filler of `len` bytes.
    pub(super) fn sent_filler(&mut self, len: usize) {
        let Stage::Sending(left) = self.stage else { return };
        self.round.bytes += len;
        self.spent += len;
        // One more frame would exceed what may be unacknowledged.
        let left = left.saturating_sub(MAX_FRAME);
        self.stage = Stage::Sending(if left < MAX_FRAME { 0 } else { left });
    }

    /// The session sent the round's ping.
    pub(super) fn sent_ping(&mut self, now: HostInstant, len: usize, token: u16) {
        self.stage = Stage::Sent(now);
        (self.round.ping_bytes, self.round.token) = (len, token);
        self.spent += len;
    }

    /// The device answered the ping of this token; `true` if it was the round's. `idle` is an idle round trip.
    pub(super) fn answered(&mut self, now: HostInstant, token: u16, idle: Duration) -> bool {
        let Round { began, bytes, ping_bytes, token: ours, .. } = self.round;
        if token != ours || !matches!(self.stage, Stage::Sent(_)) {
            return false;
        }
        self.awake(now);
        if now.since(began) >= ROUND_TIMEOUT || self.round.held_up {
            self.next_round(now);
            return true;
        }
        self.took[self.rounds] = (bytes + ping_bytes, now.since(began));
        // An idle round trip includes its ping's bytes.
        let took = now.since(began).saturating_sub(idle).as_secs_f64();
        // Too fast to measure: then it is the nominal rate.
        let rate = if took > 1e-6 { bytes as f64 / took } else { f64::from(u32::MAX) };
        self.rates[self.rounds] = (rate as u32).max(1);
        self.rounds += 1;
        self.next_round(now);
        true
    }

    /// What was measured; `None` if no round counts.
    pub(super) fn result(&self) -> Option<MeasuredLine> {
        let rate = self.rate()?;
        Some(MeasuredLine { rate, ack_wait: self.ack_wait(rate) })
    }

    fn begin_round(&mut self, now: HostInstant, bytes: usize) {
        self.round = Round { began: now, awake: now, ..Round::default() };
        self.begun += 1;
        self.stage = Stage::Sending(bytes.max(MAX_FRAME));
    }

    fn next_round(&mut self, now: HostInstant) {
        let bytes = self.rate().map_or(MAX_FRAME, LineRate::window_bytes);
        let in_budget = self.spent + bytes <= self.budget.bytes && now.since(self.began) < self.budget.time;
        if self.begun < LEAST_ROUNDS || (self.begun < ROUNDS && in_budget) {
            self.begin_round(now, bytes);
        } else {
            self.stage = Stage::Over;
        }
    }

    /// The upper quartile of the rounds: stalls of the device make rounds too slow; only an idle round trip that was
    /// itself held up makes one too fast.
    fn rate(&self) -> Option<LineRate> {
        let mut rates = self.rates;
        let rates = &mut rates[..self.rounds];
        rates.sort_unstable();
        rates.get(rates.len() * 3 / 4).map(|&rate| LineRate(rate.min(self.nominal.0)))
    }

    /// How long an acknowledgement takes on a line of this rate: the upper quartile again. A play on a link that jitters
    /// does not get the shortest round trip; the longest are stalls, which the lead covers.
    fn ack_wait(&self, line: LineRate) -> Duration {
        let mut waits = self.took.map(|(bytes, took)| took.saturating_sub(line.time(bytes)));
        let waits = &mut waits[..self.rounds];
        waits.sort_unstable();
        waits.get(waits.len() * 3 / 4).copied().unwrap_or_default()
    }
}
