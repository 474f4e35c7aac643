//! Pings and what their answers tell: that the device is there, its clock, and how long a round trip takes.
//!
//! Every answer counts as heard; only that to a ping on a quiet line sets the clock, which the session decides.
//!
//! Invariant: an answer is matched with its own ping, also when later pings have left, up to [`PINGS`] of them.

use crate::link::clock::Clock;
use crate::link::session::bounds::ClockReading;
use crate::link::session::line::RETRY;
use crate::time::HostInstant;
use firmware_protocol::tick::Tick;
use meissner_array::units::TickRate;
use std::time::Duration;

/// Round trips right after the handshake, to set the clock, and the interval of their pings.
const FIRST_PINGS: u32 = 8;
const FIRST_PING_EVERY: Duration = Duration::from_millis(2);
/// Pings that may be under way at once and still be told apart.
const PINGS: usize = 64;
/// A session that waits for a status asks this often.
const STATUS_EVERY: Duration = Duration::from_millis(1);
/// A ping still under way would be measured with the link probe's first round: the probe waits for its answer, but not longer than this.
const QUIET_TIMEOUT: Duration = Duration::from_millis(100);
/// The device counts as lost when it leaves so many pings in a row unanswered, over so long a time.
const MAX_UNANSWERED: u32 = 5;
const UNANSWERED_FOR: Duration = Duration::from_millis(400);
/// Once a ping is unanswered, the session pings this often.
const RECHECK_EVERY: Duration = Duration::from_millis(100);
/// The same while the line damages the answers.
const NOISY_EVERY: Duration = Duration::from_millis(10);
const MAX_UNANSWERED_NOISY: u32 = 40;

/// A ping and its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoundTrip {
    /// When the host sent the ping.
    pub sent: HostInstant,
    /// The device's clock when it answered.
    pub tick: Tick,
    /// When the host received the answer.
    pub received: HostInstant,
}

/// The pings of a session, and the device's clock.
#[derive(Clone, Debug)]
pub(super) struct Pinger {
    clock: Clock,
    token: u16,
    /// The last ping that the device answered.
    answered: u16,
    /// The last pings and when they left: an answer may come after later pings have left.
    pinged: [(u16, HostInstant); PINGS],
    last: HostInstant,
    due: HostInstant,
    every: Duration,
    first_pings: u32,
    unanswered: u32,
    first_unanswered: HostInstant,
    round_trip: Duration,
    /// The shortest round trip so far.
    shortest: Duration,
    last_trip: Option<RoundTrip>,
}

impl Pinger {
    pub(super) fn new(rate: TickRate, now: HostInstant) -> Self {
        Self {
            clock: Clock::new(rate),
            token: 0,
            answered: 0,
            pinged: [(0, HostInstant::default()); PINGS],
            last: HostInstant::default(),
            due: now,
            every: Duration::from_secs(1),
            first_pings: 0,
            unanswered: 0,
            first_unanswered: now,
            round_trip: RETRY.0,
            shortest: Duration::MAX,
            last_trip: None,
        }
    }

    pub(super) const fn clock(&self) -> &Clock {
        &self.clock
    }

    /// The device's clock at `now`; `None` before the handshake.
    pub(super) fn reading(&self, now: HostInstant) -> Option<ClockReading> {
        Some(ClockReading::new(&self.clock.estimate()?, self.clock.rate(), now))
    }

    /// Whether enough round trips have set the clock.
    pub(super) const fn is_set(&self) -> bool {
        self.first_pings >= FIRST_PINGS
    }

    /// About how long a round trip takes.
    pub(super) const fn round_trip(&self) -> Duration {
        self.round_trip
    }

    pub(super) const fn shortest(&self) -> Duration {
        self.shortest
    }

    /// The last round trip; each is returned once.
    pub(super) const fn take_round_trip(&mut self) -> Option<RoundTrip> {
        self.last_trip.take()
    }

    /// The handshake took this round trip. It sets the clock as far as ticks are to be widened; later ones outweigh it.
    pub(super) fn open(&mut self, sent: HostInstant, tick: Tick, now: HostInstant) {
        self.clock.round_trip(sent, tick, now);
        self.due = now;
    }

    /// The device was heard.
    pub(super) const fn heard(&mut self) {
        self.unanswered = 0;
    }

    /// When the ping of this token left, unless it is too old.
    pub(super) fn sent_at(&self, token: u16) -> Option<HostInstant> {
        let (found, sent) = self.pinged[usize::from(token) % PINGS];
        Some(sent).filter(|_| token != 0 && found == token)
    }

    /// The device answered the ping of this token.
    pub(super) const fn answered(&mut self, token: u16) {
        self.answered = token;
    }

    /// A ping on a quiet line and its answer.
    pub(super) fn measured(&mut self, trip: RoundTrip) {
        let took = trip.received.since(trip.sent);
        self.clock.round_trip(trip.sent, trip.tick, trip.received);
        self.round_trip = (self.round_trip * 7 + took) / 8;
        self.shortest = self.shortest.min(took);
        self.first_pings = self.first_pings.saturating_add(1);
        self.last_trip = Some(trip);
    }

    /// Pings at least this often.
    pub(super) fn keep_alive_every(&mut self, every: Duration, now: HostInstant) {
        self.every = every;
        self.due = self.due.min(now + every);
    }

    /// Pings soon.
    pub(super) fn hasten(&mut self) {
        self.hasten_within(STATUS_EVERY);
    }

    /// Pings within this time after the last ping.
    pub(super) fn hasten_within(&mut self, time: Duration) {
        self.due = self.due.min(self.last + time);
    }

    /// The next ping is due at `now`.
    pub(super) const fn ping_at(&mut self, now: HostInstant) {
        self.due = now;
    }

    pub(super) const fn due(&self) -> HostInstant {
        self.due
    }

    /// Sends a ping, and returns its token. `waits`: for an answer or a report; `disturbed`: the line damages answers.
    pub(super) fn ping(&mut self, now: HostInstant, waits: bool, disturbed: bool) -> u16 {
        if self.unanswered == 0 {
            self.first_unanswered = now;
        }
        self.unanswered += 1;
        let every = match self.unanswered {
            _ if waits || !self.is_set() => FIRST_PING_EVERY,
            _ if disturbed => NOISY_EVERY,
            1 => self.every,
            _ => self.every.min(RECHECK_EVERY),
        };
        (self.last, self.due) = (now, now + every);
        self.token = self.token.wrapping_add(1).max(1);
        self.pinged[usize::from(self.token) % PINGS] = (self.token, now);
        self.token
    }

    /// Whether no ping is under way, as far as that may be waited for.
    pub(super) fn is_quiet(&self, now: HostInstant) -> bool {
        self.answered == self.token || now.since(self.last) >= QUIET_TIMEOUT
    }

    /// When the line counts as quiet even without an answer.
    pub(super) fn quiet_by(&self) -> HostInstant {
        self.last + QUIET_TIMEOUT
    }

    /// Whether the device has left too many pings unanswered.
    pub(super) fn is_silent(&self, now: HostInstant, disturbed: bool) -> bool {
        let most = if disturbed { MAX_UNANSWERED_NOISY } else { MAX_UNANSWERED };
        self.unanswered >= most && now.since(self.first_unanswered) >= UNANSWERED_FOR
    }
}
