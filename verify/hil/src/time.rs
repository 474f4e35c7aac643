//! The clock of host and chip: cycles of the chip's system clock since power-up.
//!
//! At 127.5 MHz a tick has 1500 cycles, and 51 cycles are 400 ns. A host instant is a cycle, rounded down by less than one.

use firmware_protocol::tick::Tick;
use meissner_stream::time::HostInstant;

/// Cycles of a tick of 1/85 000 s.
pub const TICK: u64 = 1_500;
/// Cycles of a millisecond.
pub const MS: u64 = 127_500;
/// The host's clock at cycle 0: far from zero, as on any running machine.
const HOST_START_NS: u64 = 1_000_000_000;

/// The host's time at a cycle.
pub const fn host(cycle: u64) -> HostInstant {
    HostInstant::from_ns(HOST_START_NS + cycle * 400 / 51)
}

/// The grid of a device's ticks on the cycles: exact once its pins have pulsed, estimated before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// The cycle at which [`Tick::BOOT`] began.
    pub origin: i64,
}

impl Grid {
    /// The grid on which `tick` begins at `cycle`.
    pub const fn through(tick: Tick, cycle: u64) -> Self {
        Self { origin: cycle.cast_signed() - tick.since(Tick::BOOT) * TICK.cast_signed() }
    }

    /// The cycle at which `tick` begins.
    pub const fn cycle(self, tick: Tick) -> u64 {
        let cycle = self.origin + tick.since(Tick::BOOT) * TICK.cast_signed();
        if cycle < 0 { 0 } else { cycle.cast_unsigned() }
    }

    /// The tick at `cycle`, and the cycles of it that have passed.
    pub const fn tick(self, cycle: u64) -> (Tick, u64) {
        let since = cycle.cast_signed() - self.origin;
        let ticks = since.div_euclid(TICK.cast_signed());
        let tick = Tick(Tick::BOOT.0.saturating_add_signed(ticks));
        (tick, since.rem_euclid(TICK.cast_signed()).cast_unsigned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cycles_ticks_and_nanoseconds_fit_exactly() {
        assert_eq!(host(51).as_ns() - host(0).as_ns(), 400);
        assert_eq!(host(85_000 * TICK).as_ns() - host(0).as_ns(), 1_000_000_000);
        assert_eq!(1000 * MS, 85_000 * TICK);
        let grid = Grid::through(Tick::BOOT + 3, 5_000);
        assert_eq!(grid.cycle(Tick::BOOT + 4), 6_500);
        assert_eq!(grid.tick(6_499), (Tick::BOOT + 3, 1_499));
        assert_eq!(grid.tick(6_500), (Tick::BOOT + 4, 0));
        assert_eq!(grid.tick(400), (Tick(Tick::BOOT.0 - 1), 1_400));
    }
}
