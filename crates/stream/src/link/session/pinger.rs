//! Pings and what their answers tell: that the device is there, its clock, and how long a round trip takes.
//!
//! Every answer counts as heard and sets the clock; only that to a ping on an idle line tells how long a round trip takes.
//!
//! Invariant: an answer is matched with its own ping, also when later pings have left, up to [`PINGS`] of them.

use crate::link::clock::Clock;
use crate::link::session::bounds::ClockReading;
use crate::time::HostInstant;
use firmware_protocol::tick::Tick;
use meissner_array::units::TickRate;
use std::time::Duration;

/// Round trips right after the handshake, one after the other, to set the clock and to know how long they take; and the interval of
/// their pings on a bad line, and without an answer.
const FIRST_PINGS: u32 = TRIPS as u32;
const FIRST_PING_EVERY: Duration = Duration::from_millis(2);
const FIRST_PING_WITHIN: Duration = Duration::from_millis(50);
/// Pings that may be under way at once and still be told apart.
const PINGS: usize = 64;
/// A session that waits for a status asks this often.
const STATUS_EVERY: Duration = Duration::from_millis(1);
/// Round trips of which the upper quartile counts: a link that jitters rarely has the shortest, and the longest are stalls.
const TRIPS: usize = 8;
/// A ping without an answer for so long measures nothing.
const MEASURED_FOR: Duration = Duration::from_millis(250);
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

/// Two pings that left with moves between them.
#[derive(Clone, Copy, Debug)]
struct Pair {
    /// The second one's.
    token: u16,
    sent: HostInstant,
    /// Of the moves.
    bytes: usize,
    /// When the first one was answered.
    first: Option<HostInstant>,
}

/// What was carried between two pings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Carried {
    /// Bytes of moves.
    pub(super) bytes: usize,
    /// By how much the answer to the second ping came after that to the first one, or after an idle round trip.
    pub(super) took: Duration,
    /// Both were answered.
    pub(super) is_pair: bool,
}

/// The pings of a session, and the device's clock.
#[derive(Clone, Debug)]
pub(super) struct Pinger {
    clock: Clock,
    token: u16,
    /// The last pings and when they left: an answer may come after later pings have left.
    pinged: [(u16, HostInstant); PINGS],
    last: HostInstant,
    /// When the newest ping left that was answered.
    answered: HostInstant,
    due: HostInstant,
    every: Duration,
    first_pings: u32,
    unanswered: u32,
    first_unanswered: HostInstant,
    /// The ping under way that measures an idle line.
    measures: Option<HostInstant>,
    pair: Option<Pair>,
    /// Round trips of pings on an idle line, the last ones.
    trips: heapless::HistoryBuf<Duration, TRIPS>,
    round_trip: Option<Duration>,
    /// The shortest round trip so far.
    shortest: Duration,
    last_trip: Option<RoundTrip>,
}

impl Pinger {
    pub(super) fn new(rate: TickRate, now: HostInstant) -> Self {
        Self {
            clock: Clock::new(rate),
            token: 0,
            pinged: [(0, HostInstant::default()); PINGS],
            last: HostInstant::default(),
            answered: HostInstant::default(),
            due: now,
            every: Duration::from_secs(1),
            first_pings: 0,
            unanswered: 0,
            first_unanswered: now,
            measures: None,
            pair: None,
            trips: heapless::HistoryBuf::new(),
            round_trip: None,
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

    /// How long a round trip takes on an idle line; `None` until measured.
    pub(super) const fn round_trip(&self) -> Option<Duration> {
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

    /// The ping of this token and its answer. Returns what it tells of the moves before it.
    pub(super) fn measured(&mut self, token: u16, trip: RoundTrip) -> Option<Carried> {
        let took = trip.received.since(trip.sent);
        self.clock.round_trip(trip.sent, trip.tick, trip.received);
        self.shortest = self.shortest.min(took);
        self.first_pings = self.first_pings.saturating_add(1);
        self.last_trip = Some(trip);
        self.answered = self.answered.max(trip.sent);
        if !self.is_set() {
            self.due = trip.received;
        }
        if self.measures.take_if(|sent| *sent <= trip.sent).is_some_and(|sent| sent == trip.sent) {
            self.trips.write(took);
            let mut trips: heapless::Vec<_, TRIPS> = self.trips.oldest_ordered().copied().collect();
            trips.sort_unstable();
            self.round_trip = trips.get(trips.len() * 3 / 4).copied();
        }
        let pair = self.pair.as_mut()?;
        if token == pair.token.wrapping_sub(1) {
            pair.first = Some(trip.received);
        }
        let is_over = |pair: &mut Pair| pair.token == token || pair.sent < trip.sent;
        let Pair { bytes, first, .. } = self.pair.take_if(is_over).filter(|pair| pair.token == token)?;
        let took = match first {
            Some(first) => trip.received.since(first),
            None => took.saturating_sub(self.round_trip?),
        };
        Some(Carried { bytes, took, is_pair: first.is_some() })
    }

    /// The last ping left right behind moves of so many bytes, and the one before right before them.
    pub(super) const fn begin_pair(&mut self, bytes: usize) {
        self.pair = Some(Pair { token: self.token, sent: self.last, bytes, first: None });
    }

    /// Whether such pings are under way.
    pub(super) fn has_pair(&self, now: HostInstant) -> bool {
        self.pair.is_some_and(|pair| now.since(pair.sent) < MEASURED_FOR)
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

    /// Sends a ping, and returns its token. `waits`: for an answer or a report; `disturbed`: the line damages answers; `idle`: no moves
    /// are under way.
    pub(super) fn ping(&mut self, now: HostInstant, waits: bool, disturbed: bool, idle: bool) -> u16 {
        let is_alone = self.answered >= self.last || now.since(self.last) >= MEASURED_FOR;
        if self.unanswered == 0 {
            self.first_unanswered = now;
        }
        self.unanswered += 1;
        let every = match self.unanswered {
            _ if waits || (disturbed && !self.is_set()) => FIRST_PING_EVERY,
            // The next one follows the answer.
            _ if !self.is_set() => FIRST_PING_WITHIN,
            _ if disturbed => NOISY_EVERY,
            1 => self.every,
            _ => self.every.min(RECHECK_EVERY),
        };
        (self.last, self.due) = (now, now + every);
        if !self.is_measuring(now) {
            // Behind other pings it would measure those.
            self.measures = (idle && is_alone).then_some(now);
        }
        self.token = self.token.wrapping_add(1).max(1);
        self.pinged[usize::from(self.token) % PINGS] = (self.token, now);
        self.token
    }

    /// Whether a ping under way measures a round trip.
    pub(super) fn is_measuring(&self, now: HostInstant) -> bool {
        self.measures.is_some_and(|sent| now.since(sent) < MEASURED_FOR)
    }

    /// The host stood still: what is under way measures nothing.
    pub(super) const fn stood_still(&mut self) {
        (self.measures, self.pair) = (None, None);
    }

    /// Whether the device has left too many pings unanswered.
    pub(super) fn is_silent(&self, now: HostInstant, disturbed: bool) -> bool {
        let most = if disturbed { MAX_UNANSWERED_NOISY } else { MAX_UNANSWERED };
        self.unanswered >= most && now.since(self.first_unanswered) >= UNANSWERED_FOR
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_test_support::paper::RATE;

    fn at(ms: u64) -> HostInstant {
        HostInstant::from_ns(ms * 1_000_000)
    }

    /// A pinger whose clock is set, by round trips of 1 ms.
    fn set() -> Pinger {
        let mut pinger = Pinger::new(RATE, at(0));
        for ms in 0..u64::from(FIRST_PINGS) {
            let token = pinger.ping(at(ms), false, false, true);
            pinger.heard();
            let trip = RoundTrip { sent: at(ms), tick: Tick::BOOT + 85 * ms, received: at(ms + 1) };
            assert_eq!(pinger.measured(token, trip), None);
        }
        pinger
    }

    #[test]
    fn a_device_is_silent_after_some_pings_and_some_time() {
        for (disturbed, pings) in [(false, MAX_UNANSWERED), (true, MAX_UNANSWERED_NOISY)] {
            let (mut pinger, mut now) = (set(), at(10));
            for _ in 0..pings {
                assert!(!pinger.is_silent(now + UNANSWERED_FOR, disturbed));
                pinger.ping(now, false, disturbed, true);
                assert!(pinger.due() > now);
                now = pinger.due().min(now + Duration::from_millis(10));
            }
            assert!(
                !pinger.is_silent(at(10) + UNANSWERED_FOR / 2, disturbed)
                    && pinger.is_silent(at(10) + UNANSWERED_FOR, disturbed)
            );
            pinger.heard();
            assert!(!pinger.is_silent(at(10_000), disturbed));
        }
    }
}
