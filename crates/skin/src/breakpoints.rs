//! The breakpoints of a motor's velocity, in order of time.
//!
//! A shaft's displacement y changes at `dy/dt = D / W` with `D = r(t) - r(t - W)`. D is linear between the starts and
//! ends of ramps and W after each. A [`Breakpoint`] says when the slope of D changes, and by how much.
//!
//! D is counted in half pulses and time in half ticks. So for strokes every D is a whole number, and at rest it is exactly 0. If
//! bursts differ in their travel, D is counted in [`Parts`] of a half pulse of the motor's fastest burst.
//!
//! That a shaft follows its pulses as their mean over a window is known here alone; `blocks` knows how long a
//! pulse has an effect.
//!
//! Invariant: a motor's breakpoints are in order of time.

use firmware_protocol::tick::Tick;
use meissner_array::motor::{Excursion, Ramp};
use meissner_array::pattern::Drive;
use meissner_array::spec::{Array, MotorSpec};
use meissner_array::strokes::DriveStrokes;
use std::collections::VecDeque;

/// An instant at which the slope of a motor's velocity changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Breakpoint {
    /// Half ticks since the beginning of the scene, a whole number.
    pub(crate) at: f64,
    /// The change of the slope of D, half pulses per half tick: 1 or -1, or a whole number of parts where bursts
    /// differ in their travel.
    pub(crate) slope_change: f64,
    pub(crate) motor: u8,
}

/// The largest D of a motor, half pulses: its pulses all over the window.
pub(crate) const fn largest_d(motor: &MotorSpec) -> u64 {
    motor.window_half_ticks
}

/// The parts of a half pulse in which D is counted if bursts differ in their travel.
///
/// A half pulse has 2⁴⁰, or fewer if the largest D would have more than 2⁵³: so sums are exact and rest stays 0. Rounding loses
/// 10⁻¹² of a burst, or little more.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parts {
    /// How many a half pulse has, a power of 2, and its reciprocal.
    number: f64,
    one: f64,
}

impl Parts {
    /// The parts for such a motor.
    pub(crate) fn of(motor: &MotorSpec) -> Self {
        let number = (1_u64 << (53 - bits_of(largest_d(motor))).min(40)) as f64;
        Self { number, one: 1.0 / number }
    }

    /// A share of a half pulse, rounded to whole parts.
    #[inline]
    pub(crate) fn round(self, share: f64) -> f64 {
        // Drives are at full speed, and rounding is slow.
        if share.abs() == 1.0 { share } else { (share * self.number).round() * self.one }
    }
}

/// Bits that hold every whole number up to this one, and this one as a power of 2.
pub(crate) const fn bits_of(most: u64) -> u32 {
    most.next_power_of_two().trailing_zeros()
}

/// What a D of one half pulse makes of `scale`, which is per µm: `scale` times the velocity of the shaft, µm per half tick.
pub(crate) fn velocity_per_d(scale: f64, motor: &MotorSpec) -> f64 {
    scale * motor.um_per_pulse / 2.0 / motor.window_half_ticks as f64
}

/// Ramps of one motor, in order of time and without overlap.
pub(crate) type InOrder<'s> = Box<dyn Iterator<Item = Ramp> + Send + 's>;

/// The breakpoints of one motor: those of the window's leading edge merged with those of its trailing edge.
pub(crate) struct Breakpoints<'s> {
    motor: u8,
    ramps: InOrder<'s>,
    /// Half ticks of the moving average.
    window: f64,
    parts: Parts,
    /// The speed that counts as half a pulse per half tick, µm.
    full_um_per_tick: f64,
    /// Breakpoints that the trailing edge has not passed yet.
    behind: VecDeque<Breakpoint>,
    /// How many of `behind`, from the back, the leading edge has not passed yet.
    ahead: usize,
}

impl<'s> Breakpoints<'s> {
    /// The breakpoints of a motor's ramps, of which one of full speed counts as half a pulse per half tick.
    pub(crate) fn of(array: Array, motor: u8, ramps: InOrder<'s>, full_um_per_tick: f64) -> Self {
        let (window, parts) = (array.motor().window_half_ticks as f64, Parts::of(array.motor()));
        Self { motor, ramps, window, parts, full_um_per_tick, behind: VecDeque::new(), ahead: 0 }
    }
}

/// The ramps of a motor's drives, which are in order of time. Only strokes that begin before `end`, half ticks, count.
pub(crate) fn ramps_of(array: Array, drives: &[Drive], end: f64) -> InOrder<'_> {
    let um_per_pulse = array.motor().um_per_pulse;
    let drives = drives.iter().filter_map(move |drive| DriveStrokes::of(array, drive).ok());
    let before = move |stroke: &Excursion| half_ticks(Tick(stroke.up)) < end;
    let strokes = drives.flat_map(move |strokes| strokes.take_while(before));
    Box::new(strokes.flat_map(move |stroke| stroke.ramps(um_per_pulse)))
}

/// Those of these ramps that begin before `end`, half ticks.
pub(crate) fn ramps_before(ramps: &[Ramp], end: f64) -> InOrder<'_> {
    Box::new(ramps.iter().copied().take_while(move |ramp| half_ticks(ramp.start) < end))
}

impl Iterator for Breakpoints<'_> {
    type Item = Breakpoint;

    #[inline]
    fn next(&mut self) -> Option<Breakpoint> {
        if self.ahead == 0
            && let Some(ramp) = self.ramps.next()
        {
            let slope_change = self.parts.round(ramp.um_per_tick / self.full_um_per_tick);
            for (tick, slope_change) in [(ramp.start, slope_change), (ramp.end(), -slope_change)] {
                self.behind.push_back(Breakpoint { at: half_ticks(tick), slope_change, motor: self.motor });
            }
            self.ahead = 2;
        }
        let leading = self.ahead.checked_sub(1).map(|last| self.behind[self.behind.len() - 1 - last]);
        let trailing = self.behind.front().map(|found| Breakpoint {
            at: found.at + self.window,
            slope_change: -found.slope_change,
            ..*found
        });
        if let Some(leading) = leading
            && trailing.is_none_or(|trailing| leading.at <= trailing.at)
        {
            self.ahead -= 1;
            return Some(leading);
        }
        self.behind.pop_front();
        trailing
    }
}

fn half_ticks(tick: Tick) -> f64 {
    2.0 * tick.0 as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time;
    use meissner_array::pattern::Pattern;
    use meissner_array::random::uniform;
    use meissner_array::strokes::{StrokeOptions, Strokes};

    #[test]
    fn the_simulator_takes_the_strokes_that_are_sent() {
        let cases =
            crate::tests::arrays().into_iter().flat_map(|array| (0..50).map(move |case| (array, case)));
        for (array, case) in cases {
            let mut numbers = (0..).flat_map(|number| uniform([9, case, number, 0]));
            let mut between = |low: f64, high: f64| low + (high - low) * numbers.next().unwrap();
            let mut at = 0.0;
            let drives = [(); 3].map(|()| {
                let start = at + between(0.0, 0.1);
                at = start + between(0.0001, 0.4);
                Drive {
                    motor: 3,
                    frequency_hz: between(0.1, 300.0),
                    amplitude_um: between(0.0, array.motor().travel_um),
                    phase: between(0.0, 1.0),
                    start_s: Some(start),
                    stop_s: Some(at),
                }
            });
            let um_per_pulse = array.motor().um_per_pulse;
            let pattern = Pattern::new(array, "test", None, drives.to_vec(), toml::Table::new()).unwrap();
            let sent = Strokes::new(&pattern, &StrokeOptions::default())
                .unwrap()
                .flat_map(|stroke| stroke.unwrap().bursts());
            let ramps: Vec<_> = sent
                .map(|burst| Ramp::new(burst.start, burst.pulses.into(), burst.direction, um_per_pulse))
                .collect();
            let end = time::end(2.0, array.rate());
            let breakpoints: Vec<_> =
                Breakpoints::of(array, 3, ramps_of(array, &drives, end), um_per_pulse).collect();
            let of_ramps = Breakpoints::of(array, 3, ramps_before(&ramps, end), um_per_pulse);
            assert!(of_ramps.eq(breakpoints), "{drives:?}");
        }
    }
}
