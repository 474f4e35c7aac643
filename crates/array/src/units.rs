//! Converts between seconds, milliseconds, ticks and pulses.
//!
//! Device time is [`Tick`](firmware_protocol::tick::Tick), pattern time is seconds in `f64`, the host's time is a [`Duration`].
//! Every crate of the host converts with a [`TickRate`], which the array's description gives. Its methods differ in how they treat a
//! fraction of a tick: [`TickRate::seconds_to_ticks`] rounds, [`TickRate::duration_to_ticks`] drops it, [`TickRate::seconds_in_ticks`]
//! and [`TickRate::ms_in_ticks`] keep it. (None of them corrects for the
//! difference of the device's and the host's clock: the clock model of the link does.)
//!
//! Invariant: the order of operations in each function is part of its definition, so results are the same bit for bit.

use std::time::Duration;

/// Ticks per second of an array's device: the rate of its pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickRate(u32);

impl TickRate {
    /// So many ticks per second.
    pub const fn new(hz: u32) -> Self {
        Self(hz)
    }

    /// Ticks per second.
    pub const fn hz(self) -> u32 {
        self.0
    }

    /// Ticks of a second.
    pub const fn per_s(self) -> u64 {
        self.0 as u64
    }

    /// Half ticks of a second: the motor model counts in half ticks.
    pub const fn half_ticks_per_s(self) -> f64 {
        2.0 * self.0 as f64
    }

    /// The first tick at least `ms` milliseconds after tick 0.
    pub const fn of_ms(self, ms: u64) -> u64 {
        (ms * self.per_s()).div_ceil(1000)
    }

    /// The tick nearest to `seconds`, halves up: `floor(seconds * hz + 0.5)`. Negative or NaN: 0.
    pub fn seconds_to_ticks(self, seconds: f64) -> u64 {
        (self.seconds_in_ticks(seconds) + 0.5) as u64
    }

    /// The whole ticks of a duration.
    pub fn duration_to_ticks(self, duration: Duration) -> u64 {
        let ticks = duration.as_nanos() * u128::from(self.0) / 1_000_000_000;
        u64::try_from(ticks).unwrap_or(u64::MAX)
    }

    /// `seconds` as a number of ticks, not rounded.
    pub const fn seconds_in_ticks(self, seconds: f64) -> f64 {
        seconds * self.0 as f64
    }

    /// `ms` milliseconds as a number of ticks, not rounded.
    pub const fn ms_in_ticks(self, ms: f64) -> f64 {
        ms * self.0 as f64 / 1000.0
    }

    /// Ticks as seconds.
    pub const fn ticks_to_seconds(self, ticks: u64) -> f64 {
        ticks as f64 / self.0 as f64
    }

    /// Ticks as milliseconds.
    pub const fn ticks_to_ms(self, ticks: u64) -> f64 {
        self.ticks_to_seconds(ticks) * 1000.0
    }
}

/// Nanoseconds as milliseconds.
pub const fn ns_to_ms(ns: u64) -> f64 {
    ns as f64 / 1e6
}

/// Milliseconds as a duration.
///
/// # Panics
/// If `ms` is negative, not finite, or longer than a duration can be.
pub fn ms_to_duration(ms: f64) -> Duration {
    Duration::from_secs_f64(ms / 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE: TickRate = TickRate::new(85_000);

    #[test]
    fn seconds_round_to_the_nearest_tick_halves_up() {
        assert_eq!(RATE.seconds_to_ticks(1.0), 85_000);
        assert_eq!(RATE.seconds_to_ticks(0.5 / 85_000.0), 1);
        assert_eq!(RATE.seconds_to_ticks(0.49 / 85_000.0), 0);
        assert_eq!(RATE.seconds_to_ticks(-1.0), 0);
        assert_eq!(RATE.seconds_to_ticks(f64::NAN), 0);
    }

    #[test]
    fn a_duration_rounds_down_and_never_overflows() {
        assert_eq!(RATE.duration_to_ticks(Duration::from_secs(1)), 85_000);
        assert_eq!(RATE.duration_to_ticks(Duration::from_nanos(11_764)), 0);
        assert_eq!(RATE.duration_to_ticks(Duration::from_nanos(11_765)), 1);
        assert_eq!(RATE.duration_to_ticks(Duration::MAX), u64::MAX);
    }

    #[test]
    fn ticks_and_milliseconds_convert_both_ways() {
        assert_eq!(
            (RATE.ms_in_ticks(2.5), RATE.ticks_to_ms(170), RATE.ticks_to_seconds(85_000)),
            (212.5, 2.0, 1.0)
        );
        assert_eq!((ns_to_ms(2_500_000), ms_to_duration(2.5)), (2.5, Duration::from_micros(2_500)));
    }
}
