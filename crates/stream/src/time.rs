//! Instants of the host's clock.
//!
//! Device time is [`Tick`](firmware_protocol::tick::Tick), host time is [`HostInstant`]: two types, so that nobody mixes
//! them. [`link::Clock`](crate::link::Clock) estimates how they relate.

use rustix::rand::{GetRandomFlags, getrandom};
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};
use std::cell::Cell;
use std::ops::Add;
use std::time::Duration;

/// Unix time when a virtual clock stands at 0, ns: noon of a day, so that a test does not pass midnight.
const VIRTUAL_WALL_NS: u64 = 1_767_873_600 * 1_000_000_000;

thread_local! {
    /// What the clock reads on this thread, ns, in place of the system's.
    static CLOCK: Cell<Option<fn() -> u64>> = const { Cell::new(None) };
    /// By how much the virtual wall clock was set, ns: when the clock was given, and now.
    static WALL_SET: Cell<(i64, i64)> = const { Cell::new((0, 0)) };
    /// The state of the random numbers of a bench.
    static RANDOM: Cell<u64> = const { Cell::new(0) };
}

/// From here on [`HostInstant::now`] on this thread reads this clock, ns: that of a bench, whose time is virtual. Its wall clock was set
/// by so many ns, and its random numbers follow from the seed.
pub fn set_clock(clock: Option<fn() -> u64>, wall_set: i64, seed: u64) {
    CLOCK.set(clock);
    WALL_SET.set((wall_set, wall_set));
    RANDOM.set(seed);
}

/// A person sets the virtual wall clock: it is now so many ns from where it would be.
pub fn set_wall(by: i64) {
    WALL_SET.set((WALL_SET.get().0, by));
}

/// By how much the virtual wall clock was set since the clock was given, ns.
pub fn wall_set_since() -> i64 {
    let (before, now) = WALL_SET.get();
    now - before
}

/// Random bytes: the system's, or those of a bench's seed. Returns whether there were any.
#[must_use]
pub fn random(bytes: &mut [u8]) -> bool {
    if !is_virtual() {
        return getrandom(&mut *bytes, GetRandomFlags::empty()) == Ok(bytes.len());
    }
    for byte in bytes {
        // SplitMix64.
        let state = RANDOM.get().wrapping_add(0x9e37_79b9_7f4a_7c15);
        RANDOM.set(state);
        let mixed = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        *byte = ((mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb) >> 56) as u8;
    }
    true
}

/// Whether this thread has a virtual clock. It then does all work itself, and waits for no other thread.
pub fn is_virtual() -> bool {
    CLOCK.get().is_some()
}

/// An instant of the host's `CLOCK_MONOTONIC`, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HostInstant(u64);

impl HostInstant {
    /// The instant `ns` nanoseconds after the clock's zero.
    pub const fn from_ns(ns: u64) -> Self {
        Self(ns)
    }

    /// Reads the clock. Code that decides does not call this: its caller passes the instant.
    pub fn now() -> Self {
        if let Some(clock) = CLOCK.get() {
            return Self(clock());
        }
        let time = rustix::time::clock_gettime(ClockId::Monotonic);
        Self(time.tv_sec.cast_unsigned() * 1_000_000_000 + time.tv_nsec.cast_unsigned())
    }

    /// Reads this clock and the wall clock (Unix time, ns) at one instant. The wall clock is read between two readings of this one;
    /// of three tries the fastest counts, so an interruption does not come between them.
    pub fn now_with_wall() -> (Self, u64) {
        if is_virtual() {
            let now = Self::now();
            return (now, (VIRTUAL_WALL_NS + now.as_ns()).saturating_add_signed(WALL_SET.get().1));
        }
        let read = |_| {
            let before = Self::now();
            let wall = rustix::time::clock_gettime(ClockId::Realtime);
            let took = Self::now().since(before);
            // A clock before 1970 shows as 1970.
            let seconds = u64::try_from(wall.tv_sec).unwrap_or_default();
            (took, before + took / 2, seconds * 1_000_000_000 + wall.tv_nsec.cast_unsigned())
        };
        let (_, at, wall_ns) =
            [0, 1, 2].map(read).into_iter().min_by_key(|(took, ..)| *took).unwrap_or_default();
        (at, wall_ns)
    }

    /// Nanoseconds since the clock's zero.
    pub const fn as_ns(self) -> u64 {
        self.0
    }

    /// The time since `earlier`; zero if that is later.
    pub const fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }

    /// Nanoseconds from `earlier` to this instant, negative if that is later.
    pub const fn ns_since(self, earlier: Self) -> f64 {
        self.0.wrapping_sub(earlier.0).cast_signed() as f64
    }

    /// Sleeps until this instant; a signal may end the sleep early.
    pub fn sleep_until(self) {
        let seconds = (self.0 / 1_000_000_000).cast_signed();
        let time = Timespec { tv_sec: seconds, tv_nsec: (self.0 % 1_000_000_000).cast_signed() };
        // An error is a signal: the caller looks at the clock.
        let _ = clock_nanosleep_absolute(ClockId::Monotonic, &time);
    }

    /// The instant `by` before this one, not below the clock's zero.
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

/// Saturates at 584 years.
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
        assert_eq!((late.ns_since(early), early.ns_since(late)), (1_000_000_002.0, -1_000_000_002.0));
        assert_eq!(early + Duration::from_nanos(1_000_000_002), late);
        assert_eq!(late.before(Duration::from_nanos(1_000_000_002)), early);
        assert_eq!(early.before(Duration::MAX), HostInstant::from_ns(0));
        let due = HostInstant::now() + Duration::from_millis(1);
        due.sleep_until();
        assert!(HostInstant::now() > early);
    }

    #[test]
    fn both_clocks_of_the_host_are_read_at_one_instant() {
        let unix = || std::time::UNIX_EPOCH.elapsed().unwrap().as_nanos();
        let before = (HostInstant::now(), unix());
        let (at, wall_ns) = HostInstant::now_with_wall();
        let after = (HostInstant::now(), unix());
        assert!(before.0 <= at && at <= after.0);
        assert!((before.1..=after.1).contains(&wall_ns.into()));
    }
}
