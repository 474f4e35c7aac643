//! The work of a simulation: which receptors, in which groups, on which threads.
//!
//! Receptors are ordered by place, so that those of a group feel the same motors, and worked through by tiles: the
//! memory is that of a tile and of the answer. A tile goes through the scene block by block; within a block its
//! groups are independent and shared out over the threads.
//!
//! Invariant: the answer for a receptor depends on the scene and its number, not on tiles, blocks or threads.

use super::breaks::{Blocks, end};
use super::cycle;
use super::exact;
use super::lanes::Number;
use super::membrane::Membrane;
use super::scene::Scene;
use super::silent::Bound;
use super::stepped::{self, Block, StepModel, TILE};
use super::track::{self, Column, Track, Tracks};
use super::{
    Integrator, Keep, MOST_SPIKES, Method, MethodError, Options, Precision, Skipped, Stepping,
    step_half_ticks,
};
use crate::afferent;
use firmware_protocol::stroke::MOTORS;
use meissner_array::random::Normals;
use meissner_array::units::HALF_TICKS_PER_S;
use pulp::Arch;
use rayon::prelude::*;
use std::sync::Arc;

/// Receptors of a tile.
const RECEPTORS: usize = 4096;
/// Breaks of a motor after which it is asked who is silent: first after eight strokes, which often is enough.
const ASKED_AFTER: [usize; 3] = [64, 4096, usize::MAX];
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

/// Simulates some of a scene's receptors under what its motors do; `give` is handed each one's train, in no particular order.
pub(super) fn run(
    scene: &Scene,
    tracks: &Tracks,
    receptors: &[u32],
    options: &Options,
    progress: &(dyn Fn(f64) + Sync),
    give: impl FnMut(Train),
) -> Result<Skipped, MethodError> {
    run_on(Arch::new(), scene, tracks, receptors, options, progress, give)
}

/// The same by the vectors of a processor of our choice.
pub(super) fn run_on(
    arch: Arch,
    scene: &Scene,
    tracks: &Tracks,
    receptors: &[u32],
    options: &Options,
    progress: &(dyn Fn(f64) + Sync),
    mut give: impl FnMut(Train),
) -> Result<Skipped, MethodError> {
    let work = Work { arch, ..Work::new(scene, options, tracks, &[]) };
    work.run(&by_place(scene, receptors), progress, &mut give)
}

/// The receptors that are not proven silent, so that a method may find spikes there.
pub(super) fn audible(scene: &Scene, receptors: &[u32], options: &Options) -> Vec<u32> {
    let tracks = track::of_scene(scene, options.method);
    let work = Work::new(scene, options, &tracks, &[]);
    let members = receptors.iter().map(|&number| work.member(number));
    let mut members: Vec<_> = members.filter(|member| member.motors() != 0).collect();
    work.silent(&mut members);
    members.into_iter().map(|member| member.number).collect()
}

/// How much of a motor a receptor feels under these options. The model is linear in a motor's displacement, so that its
/// gain may be taken for the receptor's: its velocity stays the whole number with which everything is exact. What counts
/// as 0 does so without the gain.
pub(super) fn weight(scene: &Scene, options: &Options, number: u32, motor: u8) -> f64 {
    let weight = afferent::weight(scene.receptors()[number as usize], motor, scene.model().sigma_mm);
    if weight < options.least_weight { 0.0 } else { weight * scene.gains()[usize::from(motor)] }
}

/// Receptors in an order in which neighbours follow each other: by the interleaved bits of their places.
pub(super) fn by_place(scene: &Scene, receptors: &[u32]) -> Vec<u32> {
    let places = scene.receptors();
    let range = |of: fn(&afferent::Position) -> f64| {
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

pub(super) struct Work<'w> {
    scene: &'w Scene,
    options: &'w Options,
    arch: Arch,
    membrane: Membrane,
    end: f64,
    tracks: [Option<&'w Track>; MOTORS],
    /// The motors that have a track, a bit each.
    moving: u32,
    /// Members as they are when all motors move, at their numbers; empty if they are made anew.
    kept: &'w [Member],
}

impl<'w> Work<'w> {
    pub(super) fn new(
        scene: &'w Scene,
        options: &'w Options,
        tracks: &'w Tracks,
        kept: &'w [Member],
    ) -> Self {
        let (membrane, end) = (Membrane::of(scene.model()), end(scene.duration_s()));
        let tracks = std::array::from_fn(|motor| tracks[motor].as_deref());
        Self { scene, options, arch: Arch::new(), membrane, end, tracks, moving: 0, kept }.counted()
    }

    /// The same with other tracks of some motors.
    pub(super) fn with(mut self, tracks: &'w [(u8, Option<Arc<Track>>)]) -> Self {
        tracks.iter().for_each(|(motor, track)| self.tracks[usize::from(*motor)] = track.as_deref());
        self.counted()
    }

    fn counted(self) -> Self {
        let moving = self.tracks.iter().flatten().fold(0, |moving, track| moving | 1 << track.motor());
        Self { moving, ..self }
    }

    /// Simulates some receptors, in order of place.
    pub(super) fn run(
        &self,
        order: &[u32],
        progress: &(dyn Fn(f64) + Sync),
        give: &mut impl FnMut(Train),
    ) -> Result<Skipped, MethodError> {
        let motors_at_rest = MOTORS as u32 - self.moving.count_ones();
        let mut skipped = Skipped { motors_at_rest, ..Skipped::default() };
        let (mut reaching, mut kept) = (0, 0);
        let tiles = order.len().div_ceil(RECEPTORS).max(1) as f64;
        for (index, tile) in order.chunks(RECEPTORS).enumerate() {
            let part = |done: f64| progress((index as f64 + done) / tiles);
            reaching |= self.tile(tile, &mut skipped, &part, &mut |train: Train| {
                kept += train.2.len() as u64;
                give(train);
            })?;
            within_bounds(kept)?;
        }
        skipped.motors_out_of_reach = (self.moving & !reaching).count_ones();
        Ok(skipped)
    }

    /// Simulates a tile; says which motors reach it.
    fn tile(
        &self,
        numbers: &[u32],
        skipped: &mut Skipped,
        progress: &(dyn Fn(f64) + Sync),
        give: &mut impl FnMut(Train),
    ) -> Result<u32, MethodError> {
        let mut members: Vec<_> =
            numbers.par_iter().with_min_len(64).map(|&number| self.member(number)).collect();
        let reaching = felt(&members);
        if self.options.skip {
            members.retain(|member| {
                let reached = member.motors() != 0;
                if !reached {
                    skipped.receptors_out_of_reach += 1;
                    give((member.number, 0, Vec::new()));
                }
                reached
            });
            let silent = self.silent(&mut members);
            skipped.receptors_below_threshold += silent.len() as u64;
            silent.into_iter().for_each(|number| give((number, 0, Vec::new())));
        }
        match self.options.method {
            Method::Exact => skipped.repeated_receptor_s += self.exact(members, progress, give)?,
            Method::Stepped(stepping) => match stepping.precision {
                Precision::F32 => self.stepped::<f32>(stepping, members, progress, give)?,
                Precision::F64 => self.stepped::<f64>(stepping, members, progress, give)?,
            },
        }
        Ok(reaching)
    }

    fn member(&self, number: u32) -> Member {
        let moves = |motor: usize| self.moving >> motor & 1 == 1;
        let mut member = self.kept.get(number as usize).cloned().unwrap_or_else(|| self.anew(number, moves));
        for (motor, weight) in member.weights.iter_mut().enumerate() {
            *weight = if moves(motor) { *weight } else { 0.0 };
        }
        member
    }

    /// A member with its weights of some motors.
    pub(super) fn anew(&self, number: u32, of: impl Fn(usize) -> bool) -> Member {
        let weight = |motor: usize| {
            if of(motor) { weight(self.scene, self.options, number, motor as u8) } else { 0.0 }
        };
        let noisy = self.scene.model().noise_sd > 0.0;
        let mut noise = noisy.then(|| Normals::new(self.scene.seed(), number.into()));
        let resting = self.membrane.draw(noise.as_mut());
        Member { number, weights: std::array::from_fn(weight), resting, noise }
    }

    /// Takes out those that cannot reach their threshold; gives their numbers.
    fn silent(&self, members: &mut Vec<Member>) -> Vec<u32> {
        let step = match self.options.method {
            Method::Exact => 0.0,
            Method::Stepped(Stepping { step_us, integrator: Integrator::Propagator, .. }) => {
                step_half_ticks(step_us)
            }
            // Euler samples the input, so that an integral of the input does not bound it.
            Method::Stepped(_) => return Vec::new(),
        };
        let bound = Bound::new(&self.membrane, step);
        let mut silent: Vec<usize> = (0..members.len()).collect();
        // Whoever may fire needs no bound any more: often all of them, after a few strokes of each motor.
        for breaks in ASKED_AFTER {
            if silent.is_empty() {
                break;
            }
            let feel = silent.iter().fold(0, |feel, &index| feel | members[index].motors());
            let mut charges = [0.0; MOTORS];
            charges.par_iter_mut().zip(self.tracks_of(feel)).with_min_len(4).for_each(|(charge, track)| {
                *charge = track.map_or(0.0, |track| track.charge(&bound, breaks));
            });
            silent.retain(|&index| {
                !bound.reaches(&charges, &members[index].weights, members[index].threshold())
            });
        }
        let numbers = silent.iter().map(|&index| members[index].number).collect();
        let mut index = 0;
        members.retain(|_| {
            index += 1;
            silent.binary_search(&(index - 1)).is_err()
        });
        numbers
    }

    /// The tracks of some motors, a bit each.
    fn tracks_of(&self, motors: u32) -> [Option<&'w Track>; MOTORS] {
        std::array::from_fn(|motor| self.tracks[motor].filter(|_| motors >> motor & 1 == 1))
    }

    /// The receptor-seconds that were repetitions.
    fn exact(
        &self,
        members: Vec<Member>,
        progress: &(dyn Fn(f64) + Sync),
        give: &mut impl FnMut(Train),
    ) -> Result<f64, MethodError> {
        if members.is_empty() {
            return Ok(0.0);
        }
        let tracks = self.tracks_of(felt(&members));
        let mut blocks = Blocks::new(tracks.into_iter().flatten(), self.end);
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
        stepping: Stepping,
        members: Vec<Member>,
        progress: &(dyn Fn(f64) + Sync),
        give: &mut impl FnMut(Train),
    ) -> Result<(), MethodError> {
        let length = step_half_ticks(stepping.step_us);
        let model = StepModel::new(&self.membrane, stepping.integrator, length);
        let tracks = self.tracks_of(felt(&members));
        let (numbers, mut groups): (Vec<_>, Vec<_>) = grouped(members, stepped::LANES)
            .map(|(numbers, members)| (numbers, stepped::Group::<T>::new(members)))
            .unzip();
        // What comes before the receptors can be shared out is a tenth of the work: share that, too.
        let columns = tracks.into_par_iter().with_min_len(4).map(|track| track.and_then(Column::<T>::of));
        let mut columns: Vec<_> = columns.collect();
        let steps = (self.end / length).ceil() as u64;
        let mut first = 0;
        while first < steps && !groups.is_empty() {
            let count = (steps - first).min(STEPS);
            columns.par_iter_mut().flatten().for_each(|column| column.go_to(first, count as usize));
            let inputs = std::array::from_fn(|motor| columns[motor].as_ref().map_or(&[][..], Column::now));
            let block = Block {
                model: &model,
                membrane: &self.membrane,
                inputs: &inputs,
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

/// The motors that somebody feels, a bit each.
fn felt(members: &[Member]) -> u32 {
    members.iter().fold(0, |felt, member| felt | member.motors())
}

/// Whether so many spikes can be kept.
fn within_bounds(spikes: u64) -> Result<(), MethodError> {
    if spikes > MOST_SPIKES { Err(MethodError::TooManySpikes) } else { Ok(()) }
}

impl Member {
    /// The moving motors that reach it, a bit each.
    pub(super) fn motors(&self) -> u32 {
        let reaches = self.weights.iter().enumerate();
        reaches.fold(0, |motors, (motor, &weight)| motors | u32::from(weight > 0.0) << motor)
    }

    /// The threshold of its first interval.
    fn threshold(&self) -> f64 {
        self.resting.max(afferent::LEAST_THRESHOLD)
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
