//! What the line carries: its rate, as the probe measured it, and the share of it that gets through.
//!
//! It answers how much a play may need ([`Line::capacity`], [`Line::rate_beside`]) and how long the session waits before it sends
//! again. It counts no traffic: [`Wire`](super::wire::Wire) does.
//!
//! Invariant: what may be unacknowledged follows from the measured rate, or the nominal one until a probe has measured.

use crate::link::session::probe::{Budget, Probe, Step};
use crate::link::session::quality::Quality;
use crate::link::session::rate::{LineRate, MeasuredLine};
use crate::time::HostInstant;
use firmware_protocol::frame::MAX_FRAME;
use std::time::Duration;

/// The host retransmits a frame after a few round trips, within these bounds.
pub(super) const RETRY: (Duration, Duration) = (Duration::from_millis(3), Duration::from_millis(50));

/// How long after a probe that has measured nothing the next one may begin.
const PROBE_AGAIN: Duration = Duration::from_secs(1);

/// The line of a session.
#[derive(Clone, Debug)]
pub(super) struct Line {
    /// Its rate as its transport knows it, and as the probe measured it.
    nominal: LineRate,
    measured: Option<MeasuredLine>,
    /// Bytes that may be unacknowledged.
    pub(super) window_bytes: usize,
    pub(super) probe: Probe,
    /// When the last probe was over.
    probed_at: HostInstant,
    pub(super) quality: Quality,
}

impl Line {
    /// A line that is to be probed.
    pub(super) fn new(nominal: LineRate) -> Self {
        Self {
            nominal,
            measured: None,
            window_bytes: nominal.window_bytes(),
            probe: Probe::new(Budget::default(), nominal),
            probed_at: HostInstant::default(),
            quality: Quality::default(),
        }
    }

    /// Probes it again. What was measured holds until the probe is over.
    pub(super) fn probe(&mut self, budget: Budget) {
        self.probe = Probe::new(budget, self.nominal);
    }

    /// What the probe sends next; the caller sends it and says so.
    pub(super) fn next_step(&mut self, now: HostInstant, quiet: bool) -> Step {
        self.awake(now);
        let was_over = self.probe.is_over();
        let step = self.probe.next(now, quiet);
        if !was_over {
            self.adopt(now);
        }
        step
    }

    /// The host is awake.
    pub(super) fn awake(&mut self, now: HostInstant) {
        if self.probe.is_busy() {
            self.probe.awake(now);
        }
    }

    /// Whether the probe has measured nothing, and it is time to probe again.
    pub(super) fn wants_probe(&self, now: HostInstant) -> bool {
        self.probe.is_over() && self.measured.is_none() && now.since(self.probed_at) >= PROBE_AGAIN
    }

    /// The device answered the ping of this token; `true` if it was the probe's, which waits behind other bytes and so measures
    /// neither the clock nor an idle round trip. `idle` is an idle round trip.
    pub(super) fn answered(&mut self, now: HostInstant, token: u16, idle: Duration) -> bool {
        let is_probe = self.probe.answered(now, token, idle);
        if is_probe {
            self.adopt(now);
        }
        is_probe
    }

    /// Takes over what the probe measured, once it is over.
    fn adopt(&mut self, now: HostInstant) {
        if self.probe.is_over() {
            self.probed_at = now;
            self.measured = self.probe.result();
            self.window_bytes = self.measured.map_or(self.nominal, |line| line.rate).window_bytes();
        }
    }

    /// See [`Session::capacity`](super::Session::capacity).
    pub(super) fn capacity(&self) -> Option<u32> {
        let MeasuredLine { rate, ack_wait } = self.measured?;
        let under_way = (self.frames_under_way() * MAX_FRAME) as f64;
        let waiting = under_way / (ack_wait + rate.time(MAX_FRAME)).as_secs_f64();
        Some((waiting.min(rate.0.into()) * self.quality.share) as u32)
    }

    /// See [`Session::rate_beside`](super::Session::rate_beside).
    pub(super) fn rate_beside(&self, frames_per_s: u32) -> Option<(u32, f64)> {
        let share = self.quality.share;
        let waiting = f64::from(frames_per_s) * self.ack_wait()?.as_secs_f64() / share;
        Some(((f64::from(self.measured?.rate.0) * share) as u32, waiting))
    }

    /// How long a frame that is sent now takes to the device behind so many bytes; `shortest` is the shortest round trip.
    pub(super) fn delivery(&self, waiting: usize, shortest: Duration) -> Duration {
        self.time(waiting + MAX_FRAME) + shortest.min(RETRY.1) / 2
    }

    /// How long a frame waits, besides its bytes' time, until the device has acknowledged the frames before it.
    pub(super) fn ack_wait(&self) -> Option<Duration> {
        Some(self.measured?.ack_wait / self.frames_under_way() as u32)
    }

    /// How long the session waits for an acknowledgement before it sends again.
    pub(super) fn retry_after(&self, round_trip: Duration) -> Duration {
        let usual = (round_trip * 3).clamp(RETRY.0, RETRY.1);
        // A frame on a slow line is late, not lost.
        usual.max(round_trip.min(RETRY.1) + self.time(self.window_bytes + MAX_FRAME))
    }

    /// How long `bytes` occupy the line; no time while its rate is unknown.
    fn time(&self, bytes: usize) -> Duration {
        self.measured.map_or(Duration::ZERO, |line| line.rate.time(bytes))
    }

    /// Whole frames that may be unacknowledged at once.
    fn frames_under_way(&self) -> usize {
        self.window_bytes / MAX_FRAME
    }
}
