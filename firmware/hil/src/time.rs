//! The clock of a bench for host, mock and chip: cycles of the chip's system clock since power-up.
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
#[must_use]
pub const fn host(cycle: u64) -> HostInstant {
    HostInstant::from_ns(HOST_START_NS + cycle * 400 / 51)
}

/// The host's clock. The device's clock may run away from it, and it may stand still.
#[derive(Clone, Copy, Debug, Default)]
pub struct HostClock {
    /// By how much it is behind [`host`] at cycle `from`, in nanoseconds.
    behind_ns: f64,
    from: u64,
    /// By what share the device's clock runs fast since then, and by how much more each second.
    fast: f64,
    faster_per_s: f64,
}

impl HostClock {
    /// The host's time at a cycle.
    #[must_use]
    pub fn at(&self, cycle: u64) -> HostInstant {
        let right = host(cycle).as_ns();
        HostInstant::from_ns(right.saturating_add_signed(-(self.behind(cycle) as i64)))
    }

    fn behind(&self, cycle: u64) -> f64 {
        let seconds = (cycle - self.from) as f64 / (1e3 * MS as f64);
        let gained = seconds * (self.fast + self.faster_per_s * seconds / 2.0);
        self.behind_ns + 1e9 * gained
    }

    /// From this cycle on the device's clock runs fast by so many millionths, and by so many more each second.
    pub fn set_error(&mut self, cycle: u64, ppm: f64, ppm_per_s: f64) {
        let behind_ns = self.behind(cycle);
        *self = Self { behind_ns, from: cycle, fast: ppm / 1e6, faster_per_s: ppm_per_s / 1e6 };
    }

    /// It stands still for so many cycles.
    pub fn stand_still(&mut self, cycles: u64) {
        self.behind_ns += cycles as f64 * 400.0 / 51.0;
    }
}

/// The grid of a device's ticks on the cycles: exact once its pins have pulsed, estimated before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// The cycle at which [`Tick::BOOT`] began.
    pub origin: i64,
}

impl Grid {
    /// The grid on which `tick` begins at `cycle`.
    #[must_use]
    pub const fn through(tick: Tick, cycle: u64) -> Self {
        Self { origin: cycle.cast_signed() - tick.since(Tick::BOOT) * TICK.cast_signed() }
    }

    /// The cycle at which `tick` begins.
    #[must_use]
    pub const fn cycle(self, tick: Tick) -> u64 {
        let cycle = self.origin + tick.since(Tick::BOOT) * TICK.cast_signed();
        if cycle < 0 { 0 } else { cycle.cast_unsigned() }
    }

    /// The tick at `cycle`, and the cycles of it that have passed.
    #[must_use]
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
    fn a_host_whose_clock_is_slow_sees_a_device_that_is_fast() {
        let mut clock = HostClock::default();
        assert_eq!(clock.at(12_345), host(12_345));
        clock.set_error(1_000 * MS, 500.0, 0.0);
        clock.stand_still(51);
        let passed =
            |clock: &HostClock, ms: u64| clock.at((1_000 + ms) * MS).as_ns() - host(1_000 * MS).as_ns();
        assert_eq!(passed(&clock, 1_000), 1_000_000_000 - 500_000 - 400);
        clock.set_error(2_000 * MS, 0.0, 200.0);
        // 200 millionths of a second more after one second, on average half of that.
        assert_eq!(passed(&clock, 2_000), 2_000_000_000 - 500_000 - 400 - 100_000);
    }

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
