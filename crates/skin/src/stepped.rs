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
use crate::simd::{Aligned, Number};
use meissner_array::random::Normals;
use pulp::{Arch, Simd, WithSimd};
use std::array;

/// Afferents in a group: the widest vector of `f32`.
pub(crate) const LANES: usize = 16;
/// The value of "steps since the last spike" if there was none.
const NEVER: f64 = 1e30;

/// One number per lane.
type Row<T> = Aligned<[T; LANES]>;

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

/// The state of up to sixteen afferents.
#[derive(Debug)]
pub(crate) struct Group<T> {
    /// By motor.
    weights: Vec<Row<T>>,
    /// The motors that reach any of them, one bit each.
    motors: u64,
    p: Row<T>,
    /// Steps since the last spike: whole numbers plus the part of a step after the spike.
    since: Row<T>,
    resting: Row<T>,
    lanes: Vec<Lane>,
}

/// The part of a lane's state that is not in the vectors.
#[derive(Debug)]
struct Lane {
    noise: Option<Normals>,
    spikes: Vec<f64>,
    count: u64,
}

impl<T: Number> Group<T> {
    pub(crate) fn new(motors: usize, members: Vec<Member>) -> Self {
        assert!(members.len() <= LANES);
        let mut group = Self {
            weights: vec![Aligned([T::default(); LANES]); motors],
            motors: 0,
            p: Aligned([T::default(); LANES]),
            since: Aligned([T::of(NEVER); LANES]),
            // A lane without an afferent never reaches its threshold.
            resting: Aligned([T::of(f64::INFINITY); LANES]),
            lanes: Vec::with_capacity(members.len()),
        };
        for (lane, member) in members.into_iter().enumerate() {
            group.motors |= member.motors;
            member.reached_by().for_each(|(motor, weight)| group.weights[motor][lane] = T::of(weight));
            group.resting[lane] = T::of(member.resting);
            group.lanes.push(Lane { noise: member.noise, spikes: Vec::new(), count: 0 });
        }
        group
    }

    /// Goes through a block of steps.
    pub(crate) fn run(&mut self, arch: Arch, run: &Block<'_, T>) {
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
pub(crate) struct Block<'b, T> {
    pub(crate) model: &'b StepModel,
    pub(crate) membrane: &'b Membrane,
    /// The velocity of each motor that reaches any afferent, per step, in whole tiles.
    pub(crate) inputs: &'b [&'b [T]],
    pub(crate) first: u64,
    pub(crate) steps: usize,
    pub(crate) until: f64,
    pub(crate) keep: bool,
}

struct Run<'r, T> {
    group: &'r mut Group<T>,
    block: &'r Block<'r, T>,
}

impl<T: Number> WithSimd for Run<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.block.model.integrator {
            Integrator::Euler => self.steps::<S, false>(simd),
            Integrator::Propagator => self.steps::<S, true>(simd),
        }
    }
}

impl<T: Number> Run<'_, T> {
    #[inline(always)]
    fn steps<S: Simd, const WITHIN: bool>(self, simd: S) {
        let Self { group, block } = self;
        let step = Step::<T, S, WITHIN>::new(simd, block.model);
        for first in (0..group.lanes.len()).step_by(T::width::<S>()) {
            let mut registers = Registers {
                p: T::load::<S>(&group.p[first..]),
                since: T::load::<S>(&group.since[first..]),
                resting: T::load::<S>(&group.resting[first..]),
            };
            for tile in (0..block.steps).step_by(TILE) {
                let inputs = inputs(simd, block, group, first, tile);
                for (index, input) in inputs.into_iter().take(block.steps - tile).enumerate() {
                    let (after, candidates) = step.take(&registers, input);
                    let before = std::mem::replace(&mut registers, after);
                    if T::bits::<S>(candidates) != 0 {
                        let number = block.first + (tile + index) as u64;
                        let (part, spiked) = step.crossing(&before, registers.p, candidates);
                        step.reset(&mut registers, part, spiked, input);
                        let parts = spill::<T, S>(part);
                        let mut resting = spill::<T, S>(registers.resting);
                        let mut left = T::bits::<S>(spiked);
                        while left != 0 {
                            let lane = left.trailing_zeros() as usize;
                            left &= left - 1;
                            let at = (number as f64 + parts[lane].wide()) * block.model.length;
                            resting[lane] = T::of(group.lanes[first + lane].spike(block, at));
                        }
                        registers.resting = T::load::<S>(&*resting);
                    }
                }
            }
            T::store::<S>(&mut group.p[first..], registers.p);
            T::store::<S>(&mut group.since[first..], registers.since);
            T::store::<S>(&mut group.resting[first..], registers.resting);
        }
    }
}

/// The rectified inputs of a tile of steps: the motors' velocities, weighted and summed in order of motor.
#[inline(always)]
fn inputs<T: Number, S: Simd>(
    simd: S,
    block: &Block<'_, T>,
    group: &Group<T>,
    first: usize,
    tile: usize,
) -> [T::Vector<S>; TILE] {
    let zero = T::splat(simd, T::default());
    let mut sums = [zero; TILE];
    let mut left = group.motors;
    while left != 0 {
        let motor = left.trailing_zeros() as usize;
        left &= left - 1;
        let weights = T::load::<S>(&group.weights[motor][first..]);
        let input = block.inputs[motor][tile..].first_chunk::<TILE>().expect("inputs are whole tiles");
        sums = array::from_fn(|step| T::mul_add(simd, weights, T::splat(simd, input[step]), sums[step]));
    }
    match block.model.rectify {
        Rectify::Half => array::from_fn(|step| T::max(simd, sums[step], zero)),
        Rectify::Full => array::from_fn(|step| T::abs(simd, sums[step])),
        Rectify::Signed => sums,
    }
}

#[inline(always)]
fn spill<T: Number, S: Simd>(vector: T::Vector<S>) -> Row<T> {
    let mut lanes = Aligned([T::default(); LANES]);
    T::store::<S>(&mut *lanes, vector);
    lanes
}

impl Lane {
    /// Counts a spike and draws the next resting threshold.
    #[inline(always)]
    fn spike<T>(&mut self, block: &Block<'_, T>, at: f64) -> f64 {
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
struct Registers<T: Number, S: Simd> {
    p: T::Vector<S>,
    since: T::Vector<S>,
    resting: T::Vector<S>,
}

/// A [`StepModel`] with each number in every lane. `WITHIN`: it finds crossings within the step.
struct Step<T: Number, S: Simd, const WITHIN: bool> {
    simd: S,
    zero: T::Vector<S>,
    charge: T::Vector<S>,
    leak: T::Vector<S>,
    one: T::Vector<S>,
    recovery: T::Vector<S>,
    depth: T::Vector<S>,
    least: T::Vector<S>,
    refractory: T::Vector<S>,
    /// The refractory time for the test at a step's end, minus a margin for rounding, because it may be a whole number of steps.
    nearly_refractory: T::Vector<S>,
}

impl<T: Number, S: Simd, const WITHIN: bool> Step<T, S, WITHIN> {
    #[inline(always)]
    fn new(simd: S, model: &StepModel) -> Self {
        let splat = |value| T::splat(simd, T::of(value));
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
    fn take(&self, lanes: &Registers<T, S>, input: T::Vector<S>) -> (Registers<T, S>, T::Mask<S>) {
        let simd = self.simd;
        let charged = T::mul_add(simd, input, self.charge, lanes.p);
        let p = T::mul_add(simd, lanes.p, self.leak, charged);
        let since = T::add(simd, lanes.since, self.one);
        // The threshold rises with the time since the spike. Euler tests it at the step's end. A crossing within the step
        // is tested against its lowest value, at the step's start.
        let tested = if WITHIN { lanes.since } else { since };
        let threshold = self.threshold(lanes.resting, tested);
        let top = if WITHIN { T::max(simd, lanes.p, p) } else { p };
        let candidates = T::both(
            simd,
            T::at_least(simd, top, threshold),
            T::at_least(simd, since, self.nearly_refractory),
        );
        (Registers { p, since, resting: lanes.resting }, candidates)
    }

    /// Restarts the lanes that spiked with the rest of the step.
    #[inline(always)]
    fn reset(
        &self,
        lanes: &mut Registers<T, S>,
        part: T::Vector<S>,
        spiked: T::Mask<S>,
        input: T::Vector<S>,
    ) {
        let simd = self.simd;
        let rest = T::sub(simd, self.one, part);
        let charge = T::mul_add(simd, rest, self.charge, self.zero);
        lanes.p = T::select(simd, spiked, T::mul_add(simd, charge, input, self.zero), lanes.p);
        lanes.since = T::select(simd, spiked, rest, lanes.since);
    }

    /// The part of the step after which the membrane, on a straight line to `end`, first reaches the threshold; and the
    /// `candidates` lanes in which it does.
    #[inline(always)]
    fn crossing(
        &self,
        before: &Registers<T, S>,
        end: T::Vector<S>,
        candidates: T::Mask<S>,
    ) -> (T::Vector<S>, T::Mask<S>) {
        let simd = self.simd;
        if !WITHIN {
            return (self.one, candidates);
        }
        let free = T::sub(simd, self.refractory, before.since);
        let free = T::min(simd, T::max(simd, free, self.zero), self.one);
        let low = self.threshold(before.resting, before.since);
        let climb = T::sub(simd, self.threshold(before.resting, T::add(simd, before.since, self.one)), low);
        let rise = T::sub(simd, end, before.p);
        // The crossing is at the end of refractoriness if the membrane is above the threshold by then; else where the lines meet.
        let gap = T::sub(simd, low, before.p);
        let closing = T::sub(simd, rise, climb);
        let early = T::at_least(simd, T::mul_add(simd, closing, free, self.zero), gap);
        let late = T::at_least(simd, closing, gap);
        let meets = T::min(simd, T::max(simd, T::div(simd, gap, closing), free), self.one);
        (T::select(simd, early, free, meets), T::both(simd, candidates, T::either(simd, early, late)))
    }

    #[inline(always)]
    fn threshold(&self, resting: T::Vector<S>, since: T::Vector<S>) -> T::Vector<S> {
        let simd = self.simd;
        let lowered = T::max(simd, T::mul_add(simd, since, self.recovery, self.depth), self.zero);
        T::max(simd, T::sub(simd, resting, lowered), self.least)
    }
}
