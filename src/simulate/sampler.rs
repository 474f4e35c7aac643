//! The motors' velocities on a grid of steps, for the stepped methods.
//!
//! Each motor's D and its integral are followed from break to break in closed form, so a sample is exact wherever
//! the step falls. The mean of D over a step comes from the integral: it is 0 whenever the motor rests.
//!
//! Invariant: a sample does not depend on how many are asked for at a time.

use super::breaks::{Blocks, Break};
use super::lanes::Number;
use super::stepped::TILE;
use firmware_protocol::stroke::MOTORS;
use pulp::Arch;
use std::array;

/// Which velocity a step is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sample {
    /// That at its start.
    Start,
    /// The mean over it.
    Mean,
}

/// A number for each motor.
pub(super) type Row<T> = [T; MOTORS];

/// All motors between two breaks: since when, the integral of D until then, D, and its slope.
#[derive(Clone, Debug, Default)]
struct Motion {
    at: Row<f64>,
    sum: Row<f64>,
    d: Row<f64>,
    slope: Row<f64>,
}

impl Motion {
    fn pass(&mut self, found: &Break) {
        let motor = usize::from(found.motor);
        let length = found.at - self.at[motor];
        let (d, slope) = (self.d[motor], self.slope[motor]);
        self.at[motor] = found.at;
        self.sum[motor] += length * (d + 0.5 * slope * length);
        self.d[motor] = d + slope * length;
        self.slope[motor] = slope + found.bend;
    }

    #[inline(always)]
    fn sums(&self, time: f64) -> Row<f64> {
        array::from_fn(|motor| {
            let length = time - self.at[motor];
            self.sum[motor] + length * (self.d[motor] + 0.5 * self.slope[motor] * length)
        })
    }

    #[inline(always)]
    fn velocities(&self, time: f64) -> Row<f64> {
        array::from_fn(|motor| self.d[motor] + self.slope[motor] * (time - self.at[motor]))
    }
}

pub(super) struct Sampler<'s> {
    blocks: Blocks<'s>,
    block: Vec<Break>,
    /// The next break of the block.
    next: usize,
    motion: Motion,
    /// Integrals at the last instant that was sampled.
    before: Row<f64>,
    /// Half ticks of a step.
    step: f64,
    sample: Sample,
}

impl<'s> Sampler<'s> {
    pub(super) fn new(blocks: Blocks<'s>, step: f64, sample: Sample) -> Self {
        Self {
            blocks,
            block: Vec::new(),
            next: 0,
            motion: Motion::default(),
            before: [0.0; MOTORS],
            step,
            sample,
        }
    }

    /// The samples of `steps` steps from number `first` on, half pulses; filled up to whole tiles. Steps are asked
    /// for in their order.
    pub(super) fn fill<T: Number>(&mut self, arch: Arch, first: u64, rows: &mut Vec<Row<T>>, steps: usize) {
        rows.clear();
        arch.dispatch(
            #[inline(always)]
            || {
                for index in 0..steps {
                    let number = first + index as u64;
                    let row = match self.sample {
                        Sample::Start => {
                            let time = number as f64 * self.step;
                            self.pass_to(time);
                            self.motion.velocities(time)
                        }
                        Sample::Mean => {
                            let time = (number + 1) as f64 * self.step;
                            self.pass_to(time);
                            let sums = self.motion.sums(time);
                            let per_step = 1.0 / self.step;
                            let means = array::from_fn(|motor| (sums[motor] - self.before[motor]) * per_step);
                            self.before = sums;
                            means
                        }
                    };
                    rows.push(row.map(T::of));
                }
            },
        );
        rows.resize(steps.next_multiple_of(TILE), [T::default(); MOTORS]);
    }

    /// Passes the breaks up to `time`.
    #[inline(always)]
    fn pass_to(&mut self, time: f64) {
        loop {
            while let Some(found) = self.block.get(self.next) {
                if found.at > time {
                    return;
                }
                self.motion.pass(found);
                self.next += 1;
            }
            // The block's breaks are passed; those of the next one may be due, too.
            if self.blocks.reached() > time || !self.blocks.next_into(&mut self.block) {
                return;
            }
            self.next = 0;
        }
    }
}
