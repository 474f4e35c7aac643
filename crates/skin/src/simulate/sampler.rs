//! A motor's velocity on a grid of steps, for the stepped methods.
//!
//! D and its integral are followed from break to break in closed form, so a sample is exact wherever
//! the step falls. The mean of D over a step comes from the integral: it is 0 whenever the motor rests.
//!
//! Invariant: a sample does not depend on how many are asked for at a time.

use super::breaks::{Break, Breaks, end};
use super::lanes::Number;
use super::stepped::TILE;
use super::{Integrator, Method, Stepping, step_half_ticks};

pub(super) struct Sampler<'s> {
    breaks: Breaks<'s>,
    next: Option<Break>,
    /// The last break that was passed, the integral of D until then, D there and its slope since.
    at: f64,
    sum: f64,
    d: f64,
    slope: f64,
    /// The integral at the last instant that was sampled.
    before: f64,
    /// Half ticks of a step.
    step: f64,
    integrator: Integrator,
}

impl<'s> Sampler<'s> {
    /// None for a method without steps.
    pub(super) fn new(mut breaks: Breaks<'s>, method: Method) -> Option<Self> {
        let Method::Stepped(Stepping { step_us, integrator, .. }) = method else { return None };
        let (next, step) = (breaks.next(), step_half_ticks(step_us));
        Some(Self { breaks, next, at: 0.0, sum: 0.0, d: 0.0, slope: 0.0, before: 0.0, step, integrator })
    }

    /// How many steps a scene takes.
    pub(super) fn steps(&self, duration_s: f64) -> u64 {
        (end(duration_s) / self.step).ceil() as u64
    }

    /// The samples of `steps` steps from number `first` on, half pulses: for Euler the velocity at a step's start, for the
    /// propagator its mean. Filled up to whole tiles. Steps are asked for in their order.
    pub(super) fn fill<T: Number>(&mut self, first: u64, steps: usize, samples: &mut Vec<T>) {
        samples.clear();
        for number in first..first + steps as u64 {
            let sample = match self.integrator {
                Integrator::Euler => {
                    let time = number as f64 * self.step;
                    self.pass_to(time);
                    self.d + self.slope * (time - self.at)
                }
                Integrator::Propagator => {
                    let time = (number + 1) as f64 * self.step;
                    self.pass_to(time);
                    let length = time - self.at;
                    let sum = self.sum + length * (self.d + 0.5 * self.slope * length);
                    (sum - std::mem::replace(&mut self.before, sum)) * (1.0 / self.step)
                }
            };
            samples.push(T::of(sample));
        }
        samples.resize(steps.next_multiple_of(TILE), T::default());
    }

    /// Passes the breaks up to `time`.
    #[inline(always)]
    fn pass_to(&mut self, time: f64) {
        while let Some(found) = self.next.take_if(|found| found.at <= time) {
            let length = found.at - self.at;
            self.at = found.at;
            self.sum += length * (self.d + 0.5 * self.slope * length);
            self.d += self.slope * length;
            self.slope += found.bend;
            self.next = self.breaks.next();
        }
    }
}
