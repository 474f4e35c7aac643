//! A motor's velocity on a grid of time steps, for the stepped methods.
//!
//! [`Sampler`] follows D and its integral from breakpoint to breakpoint in closed form, so a sample is exact wherever
//! the step falls. The mean of D over a step comes from the integral: it is exactly 0 while the motor rests.
//!
//! Invariant: a sample does not depend on how many are requested at a time.

use crate::breakpoints::{Breakpoint, Breakpoints};
use crate::method::{Integrator, Stepping};
use meissner_array::units::TickRate;

/// Steps whose input is summed at once: as many vectors as stay in registers. Samples come in whole tiles.
pub(crate) const TILE: usize = 8;

pub(crate) struct Sampler<'s> {
    lines: Lines<'s>,
    /// The integral of D at the last sample.
    before: f64,
    /// Half ticks of a step.
    step: f64,
    integrator: Integrator,
}

/// A velocity in straight lines.
struct Lines<'s> {
    breakpoints: Breakpoints<'s>,
    next: Option<Breakpoint>,
    /// The last breakpoint that was passed, the integral of D until then, D there and its slope since.
    at: f64,
    sum: f64,
    d: f64,
    slope: f64,
}

impl<'s> Sampler<'s> {
    pub(crate) fn new(mut breakpoints: Breakpoints<'s>, stepping: Stepping, rate: TickRate) -> Self {
        let next = breakpoints.next();
        let lines = Lines { breakpoints, next, at: 0.0, sum: 0.0, d: 0.0, slope: 0.0 };
        let (step, integrator) = (stepping.half_ticks(rate), stepping.integrator);
        Self { lines, before: 0.0, step, integrator }
    }

    /// The number of steps in a scene with this end, half ticks.
    pub(crate) fn steps(&self, end: f64) -> u64 {
        (end / self.step).ceil() as u64
    }

    /// Fills in the samples of `steps` steps from number `first` on, half pulses: for Euler the velocity at the step's start, for
    /// the propagator its mean. Zeros fill up the last tile. Steps must be requested in order.
    pub(crate) fn fill(&mut self, first: u64, steps: usize, samples: &mut Vec<f64>) {
        samples.clear();
        for number in first..first + steps as u64 {
            let sample = match self.integrator {
                Integrator::Euler => self.lines.d(number as f64 * self.step),
                Integrator::Propagator => {
                    let sum = self.lines.sum((number + 1) as f64 * self.step);
                    (sum - std::mem::replace(&mut self.before, sum)) * (1.0 / self.step)
                }
            };
            samples.push(sample);
        }
        samples.resize(steps.next_multiple_of(TILE), 0.0);
    }
}

impl Lines<'_> {
    /// D at an instant, half pulses.
    fn d(&mut self, time: f64) -> f64 {
        self.pass_to(time);
        self.d + self.slope * (time - self.at)
    }

    /// The integral of D until an instant, half pulses times half ticks.
    fn sum(&mut self, time: f64) -> f64 {
        self.pass_to(time);
        let length = time - self.at;
        self.sum + length * (self.d + 0.5 * self.slope * length)
    }

    /// Passes the breakpoints up to `time`.
    #[inline(always)]
    fn pass_to(&mut self, time: f64) {
        while let Some(found) = self.next.take_if(|found| found.at <= time) {
            let length = found.at - self.at;
            self.at = found.at;
            self.sum += length * (self.d + 0.5 * self.slope * length);
            self.d += self.slope * length;
            self.slope += found.slope_change;
            self.next = self.breakpoints.next();
        }
    }
}
