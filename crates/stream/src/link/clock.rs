//! The clock model: device ticks against the host's monotonic clock.
//!
//! Each round trip gives a tick and the interval of host time in which the device read it. The shortest of the last round
//! trips (the others waited somewhere) give the offset and, once they span seconds, the drift, by regression. Ticks and host
//! time are converted here and nowhere else.
//!
//! The bound of the estimate's error is strict while the crystals keep their rate over the round trips kept. A round trip
//! alone bounds the error at its middle: the device read its tick between sending and receiving. Both clocks run straight, so
//! the bounds at two round trips bound the error at every other instant.
//!
//! Invariant: without a round trip there is no estimate.

use crate::time::HostInstant;
use firmware_protocol::tick::Tick;
use meissner_array::units::TickRate;
use std::time::Duration;

/// Round trips kept.
const SAMPLES: usize = 64;
/// Crystals are within 50 ppm each; a larger fitted drift is noise.
const MAX_DRIFT: f64 = 200e-6;
/// The largest drift of two crystals.
const UNKNOWN_DRIFT: f64 = 100e-6;
/// A drift is fitted only to round trips that span at least this, ns.
const MIN_SPAN_NS: f64 = 2e9;

/// One round trip.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sample {
    /// The middle between sending and receiving.
    at: HostInstant,
    /// Half the time between them, ns.
    half_ns: f64,
    /// The tick that the device reported.
    tick: Tick,
}

/// The clock as it is estimated now: ticks = `tick` + `phase` + `rate`·(t - `at`).
#[derive(Clone, Copy, Debug)]
pub struct ClockEstimate {
    at: HostInstant,
    tick: Tick,
    phase: f64,
    /// Ticks per ns.
    rate: f64,
    /// Bound of the error at `at`, ns.
    error_ns: f64,
    /// Bound of the rate's error, relative.
    rate_error: f64,
}

/// Estimates the device's clock.
#[derive(Clone, Debug)]
pub struct Clock {
    /// The nominal rate.
    rate: TickRate,
    samples: [Option<Sample>; SAMPLES],
    next: usize,
    fit: Option<ClockEstimate>,
}

impl Clock {
    /// A clock of this nominal rate, before the first round trip.
    pub const fn new(rate: TickRate) -> Self {
        Self { rate, samples: [None; SAMPLES], next: 0, fit: None }
    }

    /// The nominal rate.
    pub const fn rate(&self) -> TickRate {
        self.rate
    }

    /// Nominal ticks per nanosecond.
    const fn nominal(&self) -> f64 {
        self.rate.hz() as f64 * 1e-9
    }

    /// Takes a round trip: the host asked at `sent` and received the answer, `tick`, at `received`.
    pub fn round_trip(&mut self, sent: HostInstant, tick: Tick, received: HostInstant) {
        let trip = received.since(sent);
        let half_ns = trip.as_nanos() as f64 / 2.0;
        self.samples[self.next] = Some(Sample { at: sent + trip / 2, half_ns, tick });
        self.next = (self.next + 1) % SAMPLES;
        self.refit();
    }

    fn refit(&mut self) {
        let last = self.samples[(self.next + SAMPLES - 1) % SAMPLES];
        let samples = || self.samples.iter().flatten();
        let shortest = samples().map(|sample| sample.half_ns).fold(f64::INFINITY, f64::min);
        // A round trip much longer than the shortest waited on one side: an outlier.
        let good = || samples().filter(|sample| sample.half_ns <= 1.5 * shortest + 20_000.0);
        let Some(origin) = good().max_by_key(|sample| sample.at).or(last.as_ref()).copied() else { return };
        // The device was somewhere within the tick it reported: on average half a tick in.
        let point =
            |sample: &Sample| (sample.at.ns_since(origin.at), sample.tick.since(origin.tick) as f64 + 0.5);
        let count = good().count() as f64;
        let mean_t = good().map(|sample| point(sample).0).sum::<f64>() / count;
        let mean_k = good().map(|sample| point(sample).1).sum::<f64>() / count;
        let span = good().map(|sample| -point(sample).0).fold(0.0, f64::max);
        let nominal = self.nominal();
        let (mut rate, mut measured) = (nominal, false);
        if span >= MIN_SPAN_NS {
            let (mut sum_tk, mut sum_tt) = (0.0, 0.0);
            for sample in good() {
                let (t, k) = point(sample);
                sum_tk += (t - mean_t) * (k - mean_k);
                sum_tt += (t - mean_t) * (t - mean_t);
            }
            let slope = sum_tk / sum_tt;
            if (slope / nominal - 1.0).abs() <= MAX_DRIFT {
                (rate, measured) = (slope, true);
            }
        }
        // With a fitted rate use the whole line; without, the newest good point.
        let phase = if measured { mean_k - rate * mean_t } else { 0.5 };
        let error_at = |sample: &Sample| {
            let (t, k) = point(sample);
            (phase + rate * t - k).abs() / nominal + sample.half_ns + 0.5 / nominal
        };
        let error_ns = error_at(&origin);
        let by_drift = UNKNOWN_DRIFT + (rate / nominal - 1.0).abs();
        let rate_error = good()
            .filter(|sample| sample.at < origin.at)
            .map(|sample| (error_ns + error_at(sample)) / -point(sample).0)
            .fold(by_drift, f64::min);
        let (at, tick) = (origin.at, origin.tick);
        self.fit = Some(ClockEstimate { at, tick, phase, rate, error_ns, rate_error });
    }

    /// The present estimate; `None` before the first round trip.
    pub const fn estimate(&self) -> Option<ClockEstimate> {
        self.fit
    }

    /// The device's tick at a host instant; `None` before the first round trip.
    pub fn tick_at(&self, at: HostInstant) -> Option<Tick> {
        Some(self.fit?.tick_at(at))
    }
}

impl ClockEstimate {
    /// The device's tick at a host instant.
    pub fn tick_at(&self, at: HostInstant) -> Tick {
        self.after(self.ticks_to(at).floor())
    }

    /// The tick whose beginning is nearest to a host instant.
    pub fn nearest_tick(&self, at: HostInstant) -> Tick {
        self.after(self.ticks_to(at).round())
    }

    /// When a device tick begins on the host's clock.
    pub fn instant_of(&self, tick: Tick) -> HostInstant {
        let ns = (tick.since(self.tick) as f64 - self.phase) / self.rate;
        HostInstant::from_ns(self.at.as_ns().saturating_add_signed(ns.round() as i64))
    }

    /// The bound of the estimate's error at a host instant.
    pub fn uncertainty(&self, at: HostInstant) -> Duration {
        let ns = self.error_ns + self.rate_error * at.ns_since(self.at).abs();
        Duration::from_nanos(ns.ceil() as u64)
    }

    fn ticks_to(&self, at: HostInstant) -> f64 {
        self.phase + self.rate * at.ns_since(self.at)
    }

    fn after(&self, ticks: f64) -> Tick {
        Tick(self.tick.0.saturating_add_signed(ticks as i64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_test_support::paper::RATE;

    /// A device whose clock runs `ppm` fast, asked over a line with a delay there and back.
    fn trip(clock: &mut Clock, ppm: f64, at_ns: u64, there_ns: u64, back_ns: u64) {
        let tick = true_tick(clock.rate, ppm, at_ns + there_ns);
        let sent = HostInstant::from_ns(at_ns);
        clock.round_trip(sent, tick, HostInstant::from_ns(at_ns + there_ns + back_ns));
    }

    fn ticks_per_ns(rate: TickRate) -> f64 {
        f64::from(rate.hz()) * 1e-9
    }

    fn true_tick(rate: TickRate, ppm: f64, ns: u64) -> Tick {
        Tick(Tick::BOOT.0 + (ns as f64 * ticks_per_ns(rate) * (1.0 + ppm * 1e-6)) as u64)
    }

    #[test]
    fn the_error_stays_within_its_bound_on_every_line() {
        // Each line delays one way or the other, by chance, as much as the model takes for good, or steadily.
        let mut state = 1u64;
        let mut chance = |most: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % most
        };
        for line in 0..60u64 {
            let (there, back, ppm) = (chance(300_000), chance(300_000), chance(201) as f64 - 100.0);
            let (jitter, every) = (1 + chance(300_000), 10_000_000 + chance(400_000_000));
            // Every third line is to a device with another carrier.
            let rate = [RATE, TickRate::new(20_000), TickRate::new(200_000)][line as usize % 3];
            let mut clock = Clock::new(rate);
            for i in 0..200u64 {
                let at_ns = 1_000_000_000 + i * every;
                trip(&mut clock, ppm, at_ns, there + chance(jitter), back + chance(jitter));
                for later in [1_000_000, 1_000_000_000, 5_000_000_000] {
                    let tick = true_tick(rate, ppm, at_ns + later) + 1;
                    let begins = (tick.0 - Tick::BOOT.0) as f64 / ticks_per_ns(rate) / (1.0 + ppm * 1e-6);
                    let at = HostInstant::from_ns(begins.round() as u64);
                    let error = clock.estimate().unwrap().instant_of(tick).ns_since(at).abs();
                    let bound = clock.estimate().unwrap().uncertainty(at).as_nanos() as f64;
                    assert!(error <= bound + 10.0, "line {line}, trip {i}: {error} ns off, bound {bound} ns");
                }
            }
        }
    }

    #[test]
    fn conversions_are_inverse_across_the_wrap() {
        let mut clock = Clock::new(RATE);
        trip(&mut clock, 0.0, 1_000_000, 0, 0);
        for tick in [Tick::BOOT + 85, Tick(1 << 32), Tick((1 << 32) + 12_345)] {
            let at = clock.estimate().unwrap().instant_of(tick);
            assert!(clock.tick_at(at + Duration::from_micros(6)).unwrap().since(tick).abs() <= 1);
            // A tick lasts 11.8 us.
            let nearest = |at| clock.estimate().unwrap().nearest_tick(at);
            let near = Duration::from_nanos(5_500);
            assert_eq!([nearest(at), nearest(at + near), nearest(at.before(near))], [tick; 3]);
        }
    }
}
