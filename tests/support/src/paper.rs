//! The numbers of the paper's array, written out: tests compare the program with them.

use meissner_array::units::TickRate;

/// Motors.
pub const MOTORS: usize = 24;
/// Motors of a supply.
pub const MOTORS_PER_RAIL: usize = 6;
/// Motors of a driver chip.
pub const MOTORS_PER_CHIP: usize = 2;
/// Ticks from the enable of the drivers to the first pulse.
pub const DRIVER_LEAD: u32 = 43;
/// Farthest that moves and a stroke take a pin from the lower stop, pulses.
pub const WHOLE_TRAVEL: u16 = 6_900;
/// Travel of a shaft per pulse, µm.
pub const UM_PER_PULSE: f64 = 0.95 / 7.0;
/// Pulses per second.
pub const TICK_HZ: u32 = 85_000;
/// The same, to convert times.
pub const RATE: TickRate = TickRate::new(TICK_HZ);
/// Ticks of a second.
pub const TICKS_PER_S: u64 = 85_000;
/// Half ticks of a second.
pub const HALF_TICKS_PER_S: f64 = 170_000.0;
/// The window of the moving average, half ticks: 4.3 ms.
pub const WINDOW_HALF_TICKS: u64 = 731;
