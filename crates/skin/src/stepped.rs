//! The stepped methods: a fixed time step, all afferents of a group at a time.
//!
//! Forward Euler is the paper's eq. 2: the input at the step's start, and a spike at its end if the threshold is reached there. The
//! propagator takes the exact leak over a step and the mean input. It finds the crossing within the step on the straight line
//! between the ends; the rest of the step counts for the next interval. So Euler is of order 1 and the propagator of order 2,
//! unless a spike only just reaches its threshold.
//!
//! A step has at most one spike, so a refractory time far below the step is not resolved.
//!
//! Invariant: a lane's arithmetic depends only on its afferent, not on the vector's width.

use crate::member::Member;
use crate::membrane::equation::{Membrane, phi2};
use crate::membrane::{MIN_THRESHOLD, Rectify};
use crate::method::Integrator;
use crate::sampler::TILE;
use crate::simd::{Aligned, LANES, Row, bits, load, spill, store};
use meissner_array::random::Normals;
use pulp::{Arch, Simd, WithSimd};
use std::array;

/// The value of "steps since the last spike" if there was none.
const NEVER: f64 = 1e30;

/// The effect of a step on every afferent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StepModel {
    integrator: Integrator,
    rectify: Rectify,
    /// Length, half ticks.
    pub(crate) length: f64,
    /// The share of the membrane that leaks, and the charge per unit of input.
    leak: f64,
    charge: f64,
    /// Refractory time, steps.
    refractory: f64,
    depth: f64,
    /// Recovery of the threshold per step.
    recovery: f64,
}

impl StepModel {
    pub(crate) fn new(membrane: &Membrane, integrator: Integrator, length: f64) -> Self {
        let x = membrane.rate * length;
        let (leak, charge) = match integrator {
            Integrator::Euler => (x, membrane.gain * length),
            Integrator::Propagator => (-libm::expm1(-x), membrane.gain * length * (1.0 - x * phi2(x))),
        };
        Self {
            integrator,
            rectify: membrane.rectify,
            length,
            leak,
            charge,
            refractory: membrane.refractory / length,
            depth: membrane.depth,
            recovery: membrane.recovery * length,
        }
    }
}

/// The state of up to eight afferents.
#[derive(Debug)]
pub(crate) struct Group {
    /// By motor.
    weights: Vec<Row>,
    /// The motors that reach any of them, one bit each.
    motors: u64,
    p: Row,
    /// Steps since the last spike: whole numbers plus the part of a step after the spike.
    since: Row,
    resting: Row,
    lanes: Vec<Lane>,
}

/// The part of a lane's state that is not in the vectors.
#[derive(Debug)]
struct Lane {
    noise: Option<Normals>,
    spikes: Vec<f64>,
    count: u64,
}

impl Group {
    pub(crate) fn new(motors: usize, members: Vec<Member>) -> Self {
        assert!(members.len() <= LANES);
        let mut group = Self {
            weights: vec![Aligned([0.0; LANES]); motors],
            motors: 0,
            p: Aligned([0.0; LANES]),
            since: Aligned([NEVER; LANES]),
            // A lane without an afferent never reaches its threshold.
            resting: Aligned([f64::INFINITY; LANES]),
            lanes: Vec::with_capacity(members.len()),
        };
        for (lane, member) in members.into_iter().enumerate() {
            group.motors |= member.motors;
            member.reached_by().for_each(|(motor, weight)| group.weights[motor][lane] = weight);
            group.resting[lane] = member.resting;
            group.lanes.push(Lane { noise: member.noise, spikes: Vec::new(), count: 0 });
        }
        group
    }

    /// Goes through a block of steps.
    pub(crate) fn run(&mut self, arch: Arch, run: &Block<'_>) {
        arch.dispatch(Run { group: self, block: run });
    }

    /// The number of spikes in memory.
    pub(crate) fn kept(&self) -> u64 {
        self.lanes.iter().map(|lane| lane.spikes.len() as u64).sum()
    }

    /// For each afferent: the number of spikes, and their times, half ticks, if they were kept.
    pub(crate) fn into_trains(self) -> impl Iterator<Item = (u64, Vec<f64>)> {
        self.lanes.into_iter().map(|lane| (lane.count, lane.spikes))
    }
}

/// A block of steps.
pub(crate) struct Block<'b> {
    pub(crate) model: &'b StepModel,
    pub(crate) membrane: &'b Membrane,
    /// The velocity of each motor that reaches any afferent, per step, in whole tiles.
    pub(crate) inputs: &'b [&'b [f64]],
    pub(crate) first: u64,
    pub(crate) steps: usize,
    pub(crate) until: f64,
    pub(crate) keep: bool,
}

struct Run<'r> {
    group: &'r mut Group,
    block: &'r Block<'r>,
}

impl WithSimd for Run<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.block.model.integrator {
            Integrator::Euler => self.steps::<S, false>(simd),
            Integrator::Propagator => self.steps::<S, true>(simd),
        }
    }
}

impl Run<'_> {
    #[inline(always)]
    fn steps<S: Simd, const WITHIN: bool>(self, simd: S) {
        let Self { group, block } = self;
        let step = Step::<S, WITHIN>::new(simd, block.model);
        for first in (0..group.lanes.len()).step_by(S::F64_LANES) {
            let mut registers = Registers {
                p: load::<S>(&group.p, first),
                since: load::<S>(&group.since, first),
                resting: load::<S>(&group.resting, first),
            };
            for tile in (0..block.steps).step_by(TILE) {
                let inputs = inputs(simd, block, group, first, tile);
                for (index, input) in inputs.into_iter().take(block.steps - tile).enumerate() {
                    let (after, candidates) = step.take(&registers, input);
                    let before = std::mem::replace(&mut registers, after);
                    if bits(candidates, S::F64_LANES) != 0 {
                        let number = block.first + (tile + index) as u64;
                        let (part, spiked) = step.crossing(&before, registers.p, candidates);
                        step.reset(&mut registers, part, spiked, input);
                        let parts = spill::<S>(part);
                        let mut resting = spill::<S>(registers.resting);
                        let mut left = bits(spiked, S::F64_LANES);
                        while left != 0 {
                            let lane = left.trailing_zeros() as usize;
                            left &= left - 1;
                            let at = (number as f64 + parts[lane]) * block.model.length;
                            resting[lane] = group.lanes[first + lane].spike(block, at);
                        }
                        registers.resting = load::<S>(&resting, 0);
                    }
                }
            }
            store::<S>(&mut group.p, first, registers.p);
            store::<S>(&mut group.since, first, registers.since);
            store::<S>(&mut group.resting, first, registers.resting);
        }
    }
}

/// The rectified inputs of a tile of steps: the motors' velocities, weighted and summed in order of motor.
#[inline(always)]
fn inputs<S: Simd>(simd: S, block: &Block<'_>, group: &Group, first: usize, tile: usize) -> [S::f64s; TILE] {
    let zero = simd.splat_f64s(0.0);
    let mut sums = [zero; TILE];
    let mut left = group.motors;
    while left != 0 {
        let motor = left.trailing_zeros() as usize;
        left &= left - 1;
        let weights = load::<S>(&group.weights[motor], first);
        let input = block.inputs[motor][tile..].first_chunk::<TILE>().expect("inputs are whole tiles");
        sums = array::from_fn(|step| simd.mul_add_f64s(weights, simd.splat_f64s(input[step]), sums[step]));
    }
    match block.model.rectify {
        Rectify::Half => array::from_fn(|step| simd.max_f64s(sums[step], zero)),
        Rectify::Full => array::from_fn(|step| simd.abs_f64s(sums[step])),
        Rectify::Signed => sums,
    }
}

impl Lane {
    /// Counts a spike and draws the next resting threshold.
    #[inline(always)]
    fn spike(&mut self, block: &Block<'_>, at: f64) -> f64 {
        if at < block.until {
            self.count += 1;
            if block.keep {
                self.spikes.push(at);
            }
        }
        block.membrane.draw(self.noise.as_mut())
    }
}

/// Lanes in the processor's registers.
struct Registers<S: Simd> {
    p: S::f64s,
    since: S::f64s,
    resting: S::f64s,
}

/// A [`StepModel`] with each number in every lane. `WITHIN`: it finds crossings within the step.
struct Step<S: Simd, const WITHIN: bool> {
    simd: S,
    zero: S::f64s,
    charge: S::f64s,
    leak: S::f64s,
    one: S::f64s,
    recovery: S::f64s,
    depth: S::f64s,
    least: S::f64s,
    refractory: S::f64s,
    /// The refractory time for the test at a step's end, minus a margin for rounding, because it may be a whole number of steps.
    nearly_refractory: S::f64s,
}

impl<S: Simd, const WITHIN: bool> Step<S, WITHIN> {
    #[inline(always)]
    fn new(simd: S, model: &StepModel) -> Self {
        let splat = |value| simd.splat_f64s(value);
        Self {
            simd,
            zero: splat(0.0),
            charge: splat(model.charge),
            leak: splat(-model.leak),
            one: splat(1.0),
            recovery: splat(-model.recovery),
            depth: splat(model.depth),
            least: splat(MIN_THRESHOLD),
            refractory: splat(model.refractory),
            nearly_refractory: splat(model.refractory * (1.0 - 1e-6)),
        }
    }

    /// The lanes after a step without a spike, and those that may have had one.
    #[inline(always)]
    fn take(&self, lanes: &Registers<S>, input: S::f64s) -> (Registers<S>, S::m64s) {
        let simd = self.simd;
        let charged = simd.mul_add_f64s(input, self.charge, lanes.p);
        let p = simd.mul_add_f64s(lanes.p, self.leak, charged);
        let since = simd.add_f64s(lanes.since, self.one);
        // The threshold rises with the time since the spike. Euler tests it at the step's end. A crossing within the step
        // is tested against its lowest value, at the step's start.
        let tested = if WITHIN { lanes.since } else { since };
        let threshold = self.threshold(lanes.resting, tested);
        let top = if WITHIN { simd.max_f64s(lanes.p, p) } else { p };
        let candidates = simd.and_m64s(
            simd.greater_than_or_equal_f64s(top, threshold),
            simd.greater_than_or_equal_f64s(since, self.nearly_refractory),
        );
        (Registers { p, since, resting: lanes.resting }, candidates)
    }

    /// Restarts the lanes that spiked with the rest of the step.
    #[inline(always)]
    fn reset(&self, lanes: &mut Registers<S>, part: S::f64s, spiked: S::m64s, input: S::f64s) {
        let simd = self.simd;
        let rest = simd.sub_f64s(self.one, part);
        let charge = simd.mul_add_f64s(rest, self.charge, self.zero);
        lanes.p = simd.select_f64s(spiked, simd.mul_add_f64s(charge, input, self.zero), lanes.p);
        lanes.since = simd.select_f64s(spiked, rest, lanes.since);
    }

    /// The part of the step after which the membrane, on a straight line to `end`, first reaches the threshold; and the
    /// `candidates` lanes in which it does.
    #[inline(always)]
    fn crossing(&self, before: &Registers<S>, end: S::f64s, candidates: S::m64s) -> (S::f64s, S::m64s) {
        let simd = self.simd;
        if !WITHIN {
            return (self.one, candidates);
        }
        let free = simd.sub_f64s(self.refractory, before.since);
        let free = simd.min_f64s(simd.max_f64s(free, self.zero), self.one);
        let low = self.threshold(before.resting, before.since);
        let climb = simd.sub_f64s(self.threshold(before.resting, simd.add_f64s(before.since, self.one)), low);
        let rise = simd.sub_f64s(end, before.p);
        // The crossing is at the end of refractoriness if the membrane is above the threshold by then; else where the lines meet.
        let gap = simd.sub_f64s(low, before.p);
        let closing = simd.sub_f64s(rise, climb);
        let early = simd.greater_than_or_equal_f64s(simd.mul_add_f64s(closing, free, self.zero), gap);
        let late = simd.greater_than_or_equal_f64s(closing, gap);
        let meets = simd.min_f64s(simd.max_f64s(simd.div_f64s(gap, closing), free), self.one);
        (simd.select_f64s(early, free, meets), simd.and_m64s(candidates, simd.or_m64s(early, late)))
    }

    #[inline(always)]
    fn threshold(&self, resting: S::f64s, since: S::f64s) -> S::f64s {
        let simd = self.simd;
        let lowered = simd.max_f64s(simd.mul_add_f64s(since, self.recovery, self.depth), self.zero);
        simd.max_f64s(simd.sub_f64s(resting, lowered), self.least)
    }
}
