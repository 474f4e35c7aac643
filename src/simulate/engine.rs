//! The work of a simulation: which receptors, in which groups, on which threads.
//!
//! Receptors are ordered by place, so that those of a group feel the same motors, and worked through by tiles: the
//! memory is that of a tile and of the answer. A tile goes through the scene block by block; within a block its
//! groups are independent and shared out over the threads.
//!
//! Invariant: the answer for a receptor depends on the scene and its number, not on tiles, blocks or threads.

use super::breaks::{Blocks, Break, HALF_TICKS_PER_S, end, of_scene};
use super::cycle;
use super::exact;
use super::lanes::Number;
use super::membrane::Membrane;
use super::sampler::{Sample, Sampler};
use super::scene::Scene;
use super::silent::Charges;
use super::stepped::{self, Block, StepModel, TILE};
use super::{Integrator, Keep, MOST_SPIKES, Method, MethodError, Options, Precision, Skipped, Stepping};
use crate::draw::Normals;
use crate::skin;
use firmware_protocol::stroke::MOTORS;
use pulp::Arch;
use rayon::prelude::*;

/// Receptors of a tile.
const RECEPTORS: usize = 4096;
/// Breaks of a motor after which it is asked for the first time who is silent: eight strokes.
const FEW: usize = 64;
/// Steps of a block.
const STEPS: u64 = 256 * TILE as u64;

/// A receptor that is computed.
#[derive(Clone, Debug)]
pub(super) struct Member {
    pub(super) number: u32,
    pub(super) weights: [f64; MOTORS],
    pub(super) resting: f64,
    pub(super) noise: Option<Normals>,
}

/// What is found out about a receptor: its number, how many spikes, and when, half ticks, if they are kept.
pub(super) type Train = (u32, u64, Vec<f64>);

/// Simulates some of a scene's receptors; `give` is handed each one's train, in no particular order.
pub(super) fn run(
    scene: &Scene,
    receptors: &[u32],
    options: &Options,
    progress: &(dyn Fn(f64) + Sync),
    give: impl FnMut(Train),
) -> Result<Skipped, MethodError> {
    run_on(Arch::new(), scene, receptors, options, progress, give)
}

/// The same by the vectors of a processor of our choice.
pub(super) fn run_on(
    arch: Arch,
    scene: &Scene,
    receptors: &[u32],
    options: &Options,
    progress: &(dyn Fn(f64) + Sync),
    mut give: impl FnMut(Train),
) -> Result<Skipped, MethodError> {
    let work = Work::new(arch, scene, options);
    let mut skipped = Skipped::default();
    let moving = moving(scene);
    skipped.motors_at_rest = MOTORS as u32 - moving.count_ones();
    let order = by_place(scene, receptors);
    let (mut reaching, mut kept) = (0, 0);
    let tiles = order.len().div_ceil(RECEPTORS).max(1) as f64;
    for (index, tile) in order.chunks(RECEPTORS).enumerate() {
        let part = |done: f64| progress((index as f64 + done) / tiles);
        reaching |= work.tile(tile, moving, &mut skipped, &part, &mut |train: Train| {
            kept += train.2.len() as u64;
            give(train);
        })?;
        within_bounds(kept)?;
    }
    skipped.motors_out_of_reach = (moving & !reaching).count_ones();
    Ok(skipped)
}

/// The receptors that are not proven silent, so that a method may find spikes there.
pub(super) fn audible(scene: &Scene, receptors: &[u32], options: &Options) -> Vec<u32> {
    let work = Work::new(Arch::new(), scene, options);
    let moving = moving(scene);
    let members = receptors.iter().map(|&number| work.member(number, moving));
    let mut members: Vec<_> = members.filter(|member| member.motors() != 0).collect();
    work.silent(&mut members);
    members.into_iter().map(|member| member.number).collect()
}

/// The motors that play a stroke, a bit each.
fn moving(scene: &Scene) -> u32 {
    of_scene(scene).iter().fold(0, |moving, breaks| moving | 1 << breaks.motor())
}

/// How much of a motor a receptor feels under these options. The model is linear in a motor's displacement, so that its
/// gain may be taken for the receptor's: its velocity stays the whole number with which everything is exact. What counts
/// as 0 does so without the gain.
pub(super) fn weight(scene: &Scene, options: &Options, number: u32, motor: u8) -> f64 {
    let weight = skin::weight(scene.receptors()[number as usize], motor, scene.model().sigma_mm);
    if weight < options.least_weight { 0.0 } else { weight * scene.gains()[usize::from(motor)] }
}

/// Receptors in an order in which neighbours follow each other: by the interleaved bits of their places.
fn by_place(scene: &Scene, receptors: &[u32]) -> Vec<u32> {
    let places = scene.receptors();
    let range = |of: fn(&skin::Position) -> f64| {
        receptors
            .iter()
            .map(|&number| of(&places[number as usize]))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
    };
    let (x, y) = (range(|place| place.x_mm), range(|place| place.y_mm));
    let key = |number: &u32| {
        let place = places[*number as usize];
        let cell = |at: f64, (low, high): (f64, f64)| ((at - low) / (high - low) * 255.0) as u32;
        let (x, y) = (cell(place.x_mm, x), cell(place.y_mm, y));
        (0..8).fold(0, |key, bit| key | (x >> bit & 1) << (2 * bit) | (y >> bit & 1) << (2 * bit + 1))
    };
    let mut order = receptors.to_vec();
    order.sort_by_cached_key(|number| (key(number), *number));
    order
}

struct Work<'w> {
    scene: &'w Scene,
    options: &'w Options,
    arch: Arch,
    membrane: Membrane,
    end: f64,
    /// Up to where it is computed: the last step is a whole one.
    horizon: f64,
}

impl<'w> Work<'w> {
    fn new(arch: Arch, scene: &'w Scene, options: &'w Options) -> Self {
        let end = end(scene.duration_s());
        let horizon = match options.method {
            Method::Exact => end,
            Method::Stepped(Stepping { step_us, .. }) => {
                (end / step_half_ticks(step_us)).ceil() * step_half_ticks(step_us)
            }
        };
        Self { scene, options, arch, membrane: Membrane::of(scene.model()), end, horizon }
    }

    /// Simulates a tile; says which motors reach it.
    fn tile(
        &self,
        numbers: &[u32],
        moving: u32,
        skipped: &mut Skipped,
        progress: &(dyn Fn(f64) + Sync),
        give: &mut impl FnMut(Train),
    ) -> Result<u32, MethodError> {
        let mut members: Vec<_> =
            numbers.par_iter().with_min_len(64).map(|&number| self.member(number, moving)).collect();
        let reaching = members.iter().fold(0, |reaching, member| reaching | member.motors());
        let mut only = None;
        if self.options.skip {
            members.retain(|member| {
                let reached = member.motors() != 0;
                if !reached {
                    skipped.receptors_out_of_reach += 1;
                    give((member.number, 0, Vec::new()));
                }
                reached
            });
            let (silent, block) = self.silent(&mut members);
            only = block;
            skipped.receptors_below_threshold += silent.len() as u64;
            silent.into_iter().for_each(|number| give((number, 0, Vec::new())));
        }
        let blocks = only.map_or_else(
            || Blocks::new(of_scene(self.scene), self.horizon),
            |block| Blocks::single(block, self.horizon),
        );
        match self.options.method {
            Method::Exact => skipped.repeated_receptor_s += self.exact(blocks, members, progress, give)?,
            Method::Stepped(stepping) => match stepping.precision {
                Precision::F32 => self.stepped::<f32>(blocks, stepping, members, progress, give)?,
                Precision::F64 => self.stepped::<f64>(blocks, stepping, members, progress, give)?,
            },
        }
        Ok(reaching)
    }

    fn member(&self, number: u32, moving: u32) -> Member {
        let model = self.scene.model();
        let weight = |motor: usize| {
            let moves = moving >> motor & 1 == 1;
            if moves { weight(self.scene, self.options, number, motor as u8) } else { 0.0 }
        };
        let mut noise = (model.noise_sd > 0.0).then(|| Normals::new(self.scene.seed(), number.into()));
        let resting = self.membrane.draw(noise.as_mut());
        Member { number, weights: std::array::from_fn(weight), resting, noise }
    }

    /// Takes out those that cannot reach their threshold; gives their numbers, and the scene's breaks if
    /// they were a single block.
    fn silent(&self, members: &mut Vec<Member>) -> (Vec<u32>, Option<Vec<Break>>) {
        let step = match self.options.method {
            Method::Exact => 0.0,
            Method::Stepped(Stepping { step_us, integrator: Integrator::Propagator, .. }) => {
                step_half_ticks(step_us)
            }
            // Euler samples the input, so that an integral of the input does not bound it.
            Method::Stepped(_) => return (Vec::new(), None),
        };
        let mut charges = Charges::new(&self.membrane, step);
        let mut blocks = Blocks::new(of_scene(self.scene), self.horizon);
        let mut block = Vec::new();
        let mut silent: Vec<usize> = (0..members.len()).collect();
        // Whoever may fire needs no bound any more: often all of them, after a few strokes of each motor.
        while !silent.is_empty() && blocks.next_by_motor(&mut block) {
            for part in [0..FEW, FEW..usize::MAX] {
                for breaks in block.chunk_by(|a, b| a.motor == b.motor) {
                    charges.feed(&breaks[part.start.min(breaks.len())..part.end.min(breaks.len())]);
                }
                silent.retain(|&index| !charges.reaches(&members[index].weights, members[index].threshold()));
                if silent.is_empty() {
                    break;
                }
            }
        }
        let single = blocks.done() && (blocks.given() == 1);
        charges.finish(self.horizon);
        silent.retain(|&index| !charges.reaches(&members[index].weights, members[index].threshold()));
        let numbers = silent.iter().map(|&index| members[index].number).collect();
        let mut index = 0;
        members.retain(|_| {
            index += 1;
            silent.binary_search(&(index - 1)).is_err()
        });
        (numbers, single.then_some(block))
    }

    /// The receptor-seconds that were repetitions.
    fn exact(
        &self,
        mut blocks: Blocks<'_>,
        members: Vec<Member>,
        progress: &(dyn Fn(f64) + Sync),
        give: &mut impl FnMut(Train),
    ) -> Result<f64, MethodError> {
        if members.is_empty() {
            return Ok(0.0);
        }
        let keep = self.options.keep == Keep::Spikes;
        let noiseless = self.options.skip && self.scene.model().noise_sd == 0.0;
        let periods = noiseless.then(|| cycle::periods(self.scene.drives(), self.end));
        let (numbers, mut groups): (Vec<_>, Vec<_>) = grouped(members, exact::LANES)
            .map(|(numbers, members)| {
                (numbers, exact::Group::new(members, &self.membrane, periods.as_ref(), self.end))
            })
            .unzip();
        let mut block = Vec::new();
        while groups.iter().any(exact::Group::goes_on) && blocks.next_into(&mut block) {
            groups.par_iter_mut().for_each(|group| group.run(self.arch, &self.membrane, &block, keep));
            progress(blocks.reached() / self.end);
            within_bounds(groups.iter().map(exact::Group::kept).sum())?;
        }
        // What is repeated is not written out before it is known to be little enough.
        if keep {
            within_bounds(groups.iter().map(exact::Group::to_keep).sum())?;
        }
        let trains: Vec<_> =
            groups.into_par_iter().map(|group| group.finish(self.arch, &self.membrane, keep)).collect();
        let mut repeated = 0.0;
        for (numbers, (trains, half_ticks)) in numbers.into_iter().zip(trains) {
            repeated += half_ticks;
            numbers
                .into_iter()
                .zip(trains)
                .for_each(|(number, (count, spikes))| give((number, count, spikes)));
        }
        Ok(repeated / HALF_TICKS_PER_S)
    }

    fn stepped<T: Number>(
        &self,
        blocks: Blocks<'_>,
        stepping: Stepping,
        members: Vec<Member>,
        progress: &(dyn Fn(f64) + Sync),
        give: &mut impl FnMut(Train),
    ) -> Result<(), MethodError> {
        let length = step_half_ticks(stepping.step_us);
        let model = StepModel::new(&self.membrane, stepping.integrator, length);
        let sample = match stepping.integrator {
            Integrator::Euler => Sample::Start,
            Integrator::Propagator => Sample::Mean,
        };
        let (numbers, mut groups): (Vec<_>, Vec<_>) = grouped(members, stepped::LANES)
            .map(|(numbers, members)| (numbers, stepped::Group::<T>::new(members)))
            .unzip();
        let mut sampler = Sampler::new(blocks, length, sample);
        let mut rows = Vec::new();
        let steps = (self.end / length).ceil() as u64;
        let mut first = 0;
        while first < steps && !groups.is_empty() {
            let count = (steps - first).min(STEPS);
            sampler.fill(self.arch, first, &mut rows, count as usize);
            let block = Block {
                model: &model,
                membrane: &self.membrane,
                inputs: &rows,
                first,
                steps: count as usize,
                until: self.end,
                keep: self.options.keep == Keep::Spikes,
            };
            groups.par_iter_mut().for_each(|group| group.run(self.arch, &block));
            first += count;
            progress(first as f64 / steps as f64);
            within_bounds(groups.iter().map(stepped::Group::kept).sum())?;
        }
        for (numbers, group) in numbers.into_iter().zip(groups) {
            numbers
                .into_iter()
                .zip(group.into_trains())
                .for_each(|(number, (count, spikes))| give((number, count, spikes)));
        }
        Ok(())
    }
}

/// Whether so many spikes can be kept.
fn within_bounds(spikes: u64) -> Result<(), MethodError> {
    if spikes > MOST_SPIKES { Err(MethodError::TooManySpikes) } else { Ok(()) }
}

impl Member {
    /// The moving motors that reach it, a bit each.
    fn motors(&self) -> u32 {
        let reaches = self.weights.iter().enumerate();
        reaches.fold(0, |motors, (motor, &weight)| motors | u32::from(weight > 0.0) << motor)
    }

    /// The threshold of its first interval.
    fn threshold(&self) -> f64 {
        self.resting.max(skin::LEAST_THRESHOLD)
    }
}

/// Members by groups, with their numbers.
fn grouped(members: Vec<Member>, lanes: usize) -> impl Iterator<Item = (Vec<u32>, Vec<Member>)> {
    let mut members = members.into_iter();
    std::iter::from_fn(move || {
        let group: Vec<_> = members.by_ref().take(lanes).collect();
        (!group.is_empty()).then(|| (group.iter().map(|member| member.number).collect(), group))
    })
}

/// A step in half ticks, rounded once.
fn step_half_ticks(step_us: u32) -> f64 {
    f64::from(step_us) * HALF_TICKS_PER_S / 1e6
}
