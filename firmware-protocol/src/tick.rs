//! Device time: a count of pulse periods, which are as long as the carrier of the array makes them.
//!
//! In memory a [`Tick`] has 64 bits and never wraps. On the wire a [`WireTick`] has 32 bits. [`WireTick::near`] reads it as a
//! signed distance from a tick that the reader knows; ticks widen nowhere else.

use core::ops::{Add, Sub};
use serde::{Deserialize, Serialize};

/// Most ticks rendered ahead. A move that begins before the rendered end is late. While the drivers are off, so is one that
/// begins less than [`Layout::driver_lead`](crate::array::Layout::driver_lead) after it.
pub const HORIZON: u32 = 64;
/// Ticks of a block. Shells render a block, aligned to [`Tick::BOOT`], as soon as it fits the horizon, so that all shells
/// cut at the same ticks.
pub const BLOCK: u32 = HORIZON / 4;

/// A count of pulse periods on the device's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Tick(pub u64);

impl Tick {
    /// The first tick of every controller's clock: 2 550 000 ticks before the 32-bit wrap, so that every run of a few minutes
    /// crosses the wrap.
    pub const BOOT: Self = Self((1 << 32) - 2_550_000);

    /// The low 32 bits, as sent.
    pub const fn wire(self) -> WireTick {
        #[expect(clippy::cast_possible_truncation, reason = "the low half is what the wire carries")]
        WireTick((self.0 as u32).to_le_bytes())
    }

    /// `self - earlier`, signed.
    pub const fn since(self, earlier: Self) -> i64 {
        self.0.wrapping_sub(earlier.0).cast_signed()
    }
}

impl Add<u64> for Tick {
    type Output = Self;
    /// The tick `ticks` later. The count saturates after seven million years.
    fn add(self, ticks: u64) -> Self {
        Self(self.0.saturating_add(ticks))
    }
}

impl Sub for Tick {
    type Output = u64;
    /// The ticks from `rhs` to `self`; 0 if `rhs` is later.
    fn sub(self, rhs: Self) -> u64 {
        self.0.saturating_sub(rhs.0)
    }
}

/// The low 32 bits of a [`Tick`], little-endian, as sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct WireTick(pub [u8; 4]);

impl WireTick {
    /// The tick nearest to `now` that has these low bits.
    pub const fn near(self, now: Tick) -> Tick {
        #[expect(clippy::cast_possible_truncation, reason = "a distance is taken modulo 2^32")]
        let distance = u32::from_le_bytes(self.0).wrapping_sub(now.0 as u32).cast_signed();
        Tick(now.0.saturating_add_signed(distance as i64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wire_tick_widens_across_the_wrap_both_ways() {
        let wrap = 1u64 << 32;
        for now in [Tick(wrap - 5), Tick(wrap), Tick(wrap + 7), Tick(9 * wrap - 1), Tick::BOOT] {
            for distance in [-(1i64 << 30), -100, -1, 0, 1, 64, 1 << 30] {
                let tick = Tick(now.0.wrapping_add_signed(distance));
                assert_eq!(tick.wire().near(now), tick);
                assert_eq!(tick.since(now), distance);
            }
        }
    }

    #[test]
    fn a_run_of_a_few_minutes_crosses_the_wrap() {
        assert_eq!(Tick::BOOT.0 + 2_550_000, 1 << 32);
    }
}
