//! Instants of the host's clock.
//!
//! Device time is [`Tick`](firmware_protocol::tick::Tick), host time is [`HostInstant`]: two types, so that they are
//! not mixed. [`link::Clock`](crate::link::Clock) estimates how they relate.

use std::ops::Add;
use std::time::Duration;

/// An instant of the host's `CLOCK_MONOTONIC`, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HostInstant(u64);

impl HostInstant {
    /// The instant `ns` nanoseconds after the clock's zero.
    #[must_use]
    pub const fn from_ns(ns: u64) -> Self {
        Self(ns)
    }

    /// Reads the clock. Deciding code does not call this: it is handed the instant.
    #[must_use]
    pub fn now() -> Self {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        Self(time.tv_sec.cast_unsigned() * 1_000_000_000 + time.tv_nsec.cast_unsigned())
    }

    /// Nanoseconds since the clock's zero.
    #[must_use]
    pub const fn as_ns(self) -> u64 {
        self.0
    }

    /// How long after `earlier` this is; zero if it is not.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }

    /// The instant `by` before this one, not below the clock's zero.
    #[must_use]
    pub fn before(self, by: Duration) -> Self {
        Self(self.0.saturating_sub(nanoseconds(by)))
    }
}

impl Add<Duration> for HostInstant {
    type Output = Self;
    fn add(self, by: Duration) -> Self {
        Self(self.0.saturating_add(nanoseconds(by)))
    }
}

/// 584 years fit; longer counts as that.
fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn host_instants_keep_nanoseconds_and_never_wrap() {
        let (early, late) = (HostInstant::from_ns(5), HostInstant::from_ns(1_000_000_007));
        assert_eq!(late.since(early), Duration::from_nanos(1_000_000_002));
        assert_eq!(early.since(late), Duration::ZERO);
        assert_eq!(early + Duration::from_nanos(1_000_000_002), late);
        assert_eq!(late.before(Duration::from_nanos(1_000_000_002)), early);
        assert_eq!(early.before(Duration::MAX), HostInstant::from_ns(0));
        assert!(HostInstant::now() > early);
    }
}
