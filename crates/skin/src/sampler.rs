//! A motor's velocity on a grid of time steps, for the stepped methods.
//!
//! [`Sampler`] follows D and its integral from breakpoint to breakpoint in closed form, so a sample is exact wherever
//! the step falls. The mean of D over a step comes from the integral: it is exactly 0 while the motor rests. A motor that lags has
//! no breakpoints: there both come from its displacement.
//!
//! Invariant: a sample does not depend on how many are requested at a time.

use crate::breakpoints::{Breakpoint, Breakpoints};
use crate::lagging::Lagging;
use crate::method::{Integrator, Stepping};
use crate::simd::Number;
use meissner_array::units::TickRate;

/// Steps whose input is summed at once: as many vectors as stay in registers. Samples come in whole tiles.
pub(crate) const TILE: usize = 8;

pub(crate) struct Sampler<'s> {
    source: Source<'s>,
    /// The integral of D at the last sample.
    before: f64,
    /// Half ticks of a step.
    step: f64,
    integrator: Integrator,
}

enum Source<'s> {
    Lines(Lines<'s>),
    Lag(Box<Lagging<'s>>),
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
        Self::of(Source::Lines(lines), stepping, rate)
    }

    pub(crate) fn of_lag(lag: Lagging<'s>, stepping: Stepping, rate: TickRate) -> Self {
        Self::of(Source::Lag(Box::new(lag)), stepping, rate)
    }

    fn of(source: Source<'s>, stepping: Stepping, rate: TickRate) -> Self {
        let (step, integrator) = (stepping.half_ticks(rate), stepping.integrator);
        Self { source, before: 0.0, step, integrator }
    }

    /// The number of steps in a scene with this end, half ticks.
    pub(crate) fn steps(&self, end: f64) -> u64 {
        (end / self.step).ceil() as u64
    }

    /// Fills in the samples of `steps` steps from number `first` on, half pulses: for Euler the velocity at the step's start, for
    /// the propagator its mean. Zeros fill up the last tile. Steps must be requested in order.
    pub(crate) fn fill<T: Number>(&mut self, first: u64, steps: usize, samples: &mut Vec<T>) {
        samples.clear();
        for number in first..first + steps as u64 {
            let sample = match self.integrator {
                Integrator::Euler => self.source.d(number as f64 * self.step),
                Integrator::Propagator => {
                    let sum = self.source.sum((number + 1) as f64 * self.step);
                    (sum - std::mem::replace(&mut self.before, sum)) * (1.0 / self.step)
                }
            };
            samples.push(T::of(sample));
        }
        samples.resize(steps.next_multiple_of(TILE), T::default());
    }
}

impl Source<'_> {
    /// D at an instant, half pulses; of a lag its mean over the next half tick.
    fn d(&mut self, time: f64) -> f64 {
        match self {
            Self::Lines(lines) => {
                lines.pass_to(time);
                lines.d + lines.slope * (time - lines.at)
            }
            Self::Lag(lag) => {
                let at = lag.sum(time);
                lag.sum(time + 1.0) - at
            }
        }
    }

    /// The integral of D until an instant, half pulses times half ticks.
    fn sum(&mut self, time: f64) -> f64 {
        match self {
            Self::Lines(lines) => {
                lines.pass_to(time);
                let length = time - lines.at;
                lines.sum + length * (lines.d + 0.5 * lines.slope * length)
            }
            Self::Lag(lag) => lag.sum(time),
        }
    }
}

impl Lines<'_> {
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
