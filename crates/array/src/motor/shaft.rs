//! The exact displacement of a shaft, from the ramps of its commanded position.
//!
//! `y(t) = (1/W) ∫ r` over a window W, a whole number of half ticks. The share of a ramp in that integral is
//! a polynomial in whole half ticks since the ramp's start, so it is an integer until it is multiplied by the ramp's speed. Its
//! precision does not depend on how late it is. A ramp that ended W ago is added to a base and dropped.
//!
//! Push ramps in order of time, and ask only about instants from the start of the newest ramp on. This bounds the memory: the
//! shortest ramp is one pulse, so the window holds one ramp per tick, the one at its far edge and the newest.

use crate::spec::MotorSpec;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use std::collections::VecDeque;

/// An instant of device time in half ticks: all breakpoints of the model are multiples of one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct HalfTick(pub u64);

impl From<Tick> for HalfTick {
    fn from(tick: Tick) -> Self {
        Self(tick.0.saturating_mul(2))
    }
}

impl HalfTick {
    /// Half ticks from `earlier` to here, signed.
    const fn since(self, earlier: Self) -> i64 {
        self.0.wrapping_sub(earlier.0).cast_signed()
    }
}

/// A segment of constant speed of the commanded position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ramp {
    /// When it begins.
    pub start: Tick,
    /// How long it lasts.
    pub ticks: u32,
    /// Speed, positive towards the finger: the travel per pulse times a gain.
    pub um_per_tick: f64,
}

impl Ramp {
    /// `ticks` pulses from `start` on, each with this travel.
    pub fn new(start: Tick, ticks: u32, direction: Direction, um_per_pulse: f64) -> Self {
        let um_per_tick = match direction {
            Direction::Up => um_per_pulse,
            Direction::Down => -um_per_pulse,
        };
        Self { start, ticks, um_per_tick }
    }

    /// A burst with a measured travel, µm, upwards positive, at constant speed. Without pulses it has no travel.
    pub fn travelled(start: Tick, pulses: u32, travel_um: f64) -> Self {
        let um_per_tick = if pulses == 0 { 0.0 } else { travel_um / f64::from(pulses) };
        Self { start, ticks: pulses, um_per_tick }
    }

    /// The first tick after the ramp.
    pub fn end(&self) -> Tick {
        self.start + u64::from(self.ticks)
    }

    fn half_ticks(&self) -> i64 {
        2 * i64::from(self.ticks)
    }

    fn travel_um(&self) -> f64 {
        f64::from(self.ticks) * self.um_per_tick
    }

    /// Half ticks of the ramp that are over, `after` half ticks after its start.
    fn done(&self, after: i64) -> i64 {
        after.clamp(0, self.half_ticks())
    }

    /// The ramp's share in the displacement of such a motor at an instant, µm.
    pub fn share_um(&self, at: HalfTick, motor: &MotorSpec) -> f64 {
        self.share_after(at.since(self.start.into()), motor.window_half_ticks.cast_signed())
    }

    /// The ramp's share in the displacement, `after` half ticks after its start, µm. A moving average is the mean of its travel over the
    /// window; `before` is the part that lies before it.
    #[inline]
    fn share_after(&self, after: i64, window: i64) -> f64 {
        let before = self.done(after.saturating_sub(window));
        let left = self.half_ticks() - before;
        if left == 0 {
            return self.travel_um();
        }
        let inside = after.clamp(0, window);
        let done = inside.min(left);
        let twice_area = 2 * window * before + done * (2 * inside - done);
        // A factor 1/2 for the doubled area, and one for half ticks.
        self.um_per_tick * (twice_area as f64 / (4 * window) as f64)
    }
}

/// The state of one shaft: where it rested before the window, and the ramps since.
#[derive(Debug)]
pub struct Shaft {
    base_um: f64,
    ramps: VecDeque<Ramp>,
    /// The window, half ticks.
    window: i64,
}

impl Shaft {
    /// The shaft of such a motor, at rest at 0.
    pub fn new(motor: &MotorSpec) -> Self {
        let window = motor.window_half_ticks.cast_signed();
        Self { base_um: 0.0, ramps: VecDeque::with_capacity(most_ramps(window)), window }
    }

    /// Returns to rest at 0. Keeps the memory.
    pub fn reset(&mut self) {
        self.base_um = 0.0;
        self.ramps.clear();
    }

    /// Adds the next ramp, which must not begin before the end of the last. A ramp that begins where the last ended and has
    /// the same speed prolongs it. From now on, ask about no instant before its start.
    pub fn push(&mut self, ramp: Ramp) {
        debug_assert!(self.ramps.back().is_none_or(|last| last.end() <= ramp.start), "{ramp:?} out of order");
        if ramp.ticks == 0 {
            return;
        }
        while let Some(oldest) = self.ramps.front()
            && ramp.start.since(oldest.end()) * 2 >= self.window
        {
            self.base_um += oldest.travel_um();
            self.ramps.pop_front();
        }
        if let Some(last) = self.ramps.back_mut()
            && last.end() == ramp.start
            && last.um_per_tick.to_bits() == ramp.um_per_tick.to_bits()
            && let Some(ticks) = last.ticks.checked_add(ramp.ticks)
        {
            last.ticks = ticks;
        } else {
            self.ramps.push_back(ramp);
        }
        debug_assert!(self.ramps.len() <= most_ramps(self.window));
    }

    /// The commanded position r, µm.
    pub fn position_um(&self, at: HalfTick) -> f64 {
        self.ramps.iter().fold(self.base_um, |sum, ramp| {
            sum + ramp.um_per_tick * (ramp.done(at.since(ramp.start.into())) as f64 / 2.0)
        })
    }

    /// The displacement y, µm: the mean of r over the window that ends `at`.
    pub fn displacement_um(&self, at: HalfTick) -> f64 {
        self.ramps
            .iter()
            .fold(self.base_um, |sum, ramp| sum + ramp.share_after(at.since(ramp.start.into()), self.window))
    }

    /// dy/dt, (r(t) - r(t - W)) / W, µm per tick. Linear between the starts and ends of ramps and W after each.
    pub fn velocity_um_per_tick(&self, at: HalfTick) -> f64 {
        let change = self.ramps.iter().fold(0.0, |sum, ramp| {
            let after = at.since(ramp.start.into());
            sum + ramp.um_per_tick * (ramp.done(after) - ramp.done(after - self.window)) as f64
        });
        change / self.window as f64
    }
}

/// A shaft and the ramps that it has not begun, asked at instants in order of time.
#[derive(Debug)]
pub(crate) struct Path {
    shaft: Shaft,
    ahead: VecDeque<Ramp>,
}

impl Path {
    pub(crate) fn new(motor: &MotorSpec) -> Self {
        Self { shaft: Shaft::new(motor), ahead: VecDeque::new() }
    }

    /// Adds the next ramps, in order of time.
    pub(crate) fn extend(&mut self, ramps: impl Iterator<Item = Ramp>) {
        self.ahead.extend(ramps);
    }

    /// The displacement at an instant not before the last one, µm.
    pub(crate) fn um_at(&mut self, at: HalfTick) -> f64 {
        while let Some(ramp) = self.ahead.pop_front_if(|ramp| HalfTick::from(ramp.start) <= at) {
            self.shaft.push(ramp);
        }
        self.shaft.displacement_um(at)
    }
}

/// Ramps that can matter at once: one per tick of the window, the one at its far edge, the newest.
const fn most_ramps(window: i64) -> usize {
    window.unsigned_abs() as usize / 2 + 3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::Array;

    /// The paper's: 0.95 µm for 7 pulses, 4.3 ms.
    const UM_PER_PULSE: f64 = 0.95 / 7.0;
    const WINDOW_HALF_TICKS: u64 = 731;

    fn shaft() -> Shaft {
        Shaft::new(Array::paper().motor())
    }

    fn up(start: u64, ticks: u32) -> Ramp {
        Ramp::new(Tick(start), ticks, Direction::Up, UM_PER_PULSE)
    }

    fn down(start: u64, ticks: u32) -> Ramp {
        Ramp::new(Tick(start), ticks, Direction::Down, UM_PER_PULSE)
    }

    #[test]
    fn a_shaft_moves_as_the_mean_of_its_ramps_and_comes_back_to_exactly_zero() {
        let mut shaft = shaft();
        shaft.push(up(100, 100));
        assert_eq!(shaft.displacement_um(HalfTick(200)), 0.0);
        // The integral of a ramp of 100 ticks, 60 ticks in: 60²/2 of 365.5.
        let expected = UM_PER_PULSE * 60.0 * 60.0 / 2.0 / 365.5;
        assert!((shaft.displacement_um(HalfTick(320)) - expected).abs() < 1e-12);
        let travel = 100.0 * UM_PER_PULSE;
        assert_eq!(shaft.displacement_um(HalfTick(400 + WINDOW_HALF_TICKS)), travel);
        assert_eq!(shaft.position_um(HalfTick(300)), travel / 2.0);
        assert_eq!(shaft.position_um(HalfTick(401)), travel);
        shaft.push(down(1000, 100));
        assert_eq!(shaft.displacement_um(HalfTick(2200 + WINDOW_HALF_TICKS)), 0.0);
        assert_eq!(shaft.velocity_um_per_tick(HalfTick(2200 + WINDOW_HALF_TICKS)), 0.0);
        // 100 years on.
        assert_eq!(shaft.displacement_um(HalfTick(2 * 85_000 * 3_155_760_000)), 0.0);
    }

    #[test]
    fn a_ramp_in_pieces_is_one_ramp() {
        let (mut whole, mut pieces) = (shaft(), shaft());
        whole.push(up(10, 500));
        (0..500).for_each(|tick| pieces.push(up(10 + tick, 1)));
        let at = HalfTick(1021);
        assert_eq!(whole.displacement_um(at).to_bits(), pieces.displacement_um(at).to_bits());
    }

    #[test]
    fn the_shortest_ramps_fill_the_window_and_no_more() {
        let mut shaft = shaft();
        let room = shaft.ramps.capacity();
        for tick in 0..10_000 {
            shaft.push(if tick % 2 == 0 { up(tick, 1) } else { down(tick, 1) });
        }
        assert!(shaft.ramps.len() <= most_ramps(731) && shaft.ramps.capacity() == room);
        assert!((shaft.displacement_um(HalfTick(20_000)) - UM_PER_PULSE / 2.0).abs() < 1e-3);
    }
}
