//! The motors' velocities on a grid of steps, for the stepped methods.
//!
//! Each motor's D and its integral are followed from break to break in closed form, so a sample is exact wherever
//! the step falls. The mean of D over a step comes from the integral: it is 0 whenever the motor rests.
//!
//! Invariant: a sample does not depend on how many are asked for at a time.

use super::breaks::{Break, Breaks};
use super::lanes::Number;
use super::stepped::TILE;
use firmware_protocol::stroke::MOTORS;
use pulp::Arch;

/// Which velocity a step is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sample {
    /// That at its start.
    Start,
    /// The mean over it.
    Mean,
}

/// One motor between two breaks.
#[derive(Clone, Copy, Debug, Default)]
struct Motion {
    at: f64,
    /// The integral of D until then, D, and its slope.
    sum: f64,
    d: f64,
    slope: f64,
}

impl Motion {
    fn sum_after(&self, length: f64) -> f64 {
        self.sum + length * (self.d + 0.5 * self.slope * length)
    }

    fn pass(&mut self, at: f64, bend: f64) {
        let length = at - self.at;
        *self = Self {
            at,
            sum: self.sum_after(length),
            d: self.d + self.slope * length,
            slope: self.slope + bend,
        };
    }
}

pub(super) struct Sampler<'s> {
    motors: Vec<(Breaks<'s>, Option<Break>, Motion)>,
    /// Half ticks of a step.
    step: f64,
    sample: Sample,
    /// One motor's samples, before they are rounded.
    sums: Vec<f64>,
}

impl<'s> Sampler<'s> {
    pub(super) fn new(motors: Vec<Breaks<'s>>, step: f64, sample: Sample) -> Self {
        let motors = motors.into_iter().map(|mut breaks| {
            let first = breaks.next();
            (breaks, first, Motion::default())
        });
        Self { motors: motors.collect(), step, sample, sums: Vec::new() }
    }

    /// The samples of the steps from `first` on: a row for each motor, half pulses, filled up to whole tiles.
    pub(super) fn fill<T: Number>(
        &mut self,
        arch: Arch,
        first: u64,
        rows: &mut [Vec<T>; MOTORS],
        steps: usize,
    ) {
        let padded = steps.next_multiple_of(TILE);
        for row in rows.iter_mut() {
            row.clear();
            row.resize(padded, T::default());
        }
        for (breaks, next, motion) in &mut self.motors {
            let row = &mut rows[usize::from(breaks.motor())][..steps];
            let sums = &mut self.sums;
            sums.clear();
            sums.resize(steps + 1, 0.0);
            let (step, sample) = (self.step, self.sample);
            arch.dispatch(
                #[inline(always)]
                || {
                    walk(breaks, next, motion, first as f64, step, sample, sums);
                    match sample {
                        Sample::Start => {
                            row.iter_mut().zip(&*sums).for_each(|(d, &sample)| *d = T::of(sample))
                        }
                        Sample::Mean => {
                            let per_step = 1.0 / step;
                            for (d, pair) in row.iter_mut().zip(sums.windows(2)) {
                                *d = T::of((pair[1] - pair[0]) * per_step);
                            }
                        }
                    }
                },
            );
        }
    }
}

/// D, or its integral, at the grid's instants from `first` on. From break to break, so that the loop over the
/// samples between is plain.
#[inline(always)]
fn walk(
    breaks: &mut Breaks<'_>,
    next: &mut Option<Break>,
    motion: &mut Motion,
    first: f64,
    step: f64,
    sample: Sample,
    samples: &mut [f64],
) {
    let time = |index: usize| (first + f64::from(index as u32)) * step;
    let per_step = 1.0 / step;
    let mut from = 0;
    while from < samples.len() {
        while let Some(found) = next.take_if(|found| found.at <= time(from)) {
            motion.pass(found.at, found.bend);
            *next = breaks.next();
        }
        let until = next.map_or(f64::INFINITY, |next| next.at);
        // About where the next break is; then exactly.
        let mut to = ((until * per_step - first) as usize).clamp(from + 1, samples.len());
        while to > from + 1 && time(to - 1) >= until {
            to -= 1;
        }
        while to < samples.len() && time(to) < until {
            to += 1;
        }
        let Motion { at, sum, d, slope } = *motion;
        for (index, value) in samples[from..to].iter_mut().enumerate() {
            let length = (first + f64::from((from + index) as u32)) * step - at;
            *value = match sample {
                Sample::Start => d + slope * length,
                Sample::Mean => sum + length * (d + 0.5 * slope * length),
            };
        }
        from = to;
    }
}
