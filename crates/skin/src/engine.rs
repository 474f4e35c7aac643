//! Runs a simulation: distributes afferents to groups, and groups to threads.
//!
//! [`Work`] orders afferents by place, so that the same motors reach the members of a group. It takes them tile by tile, so memory
//! holds one tile and the answer. A tile goes through the scene block by block. Within a block its groups are independent, so the
//! threads share them.
//!
//! Invariant: the answer for an afferent depends on the scene and its number, not on tiles, blocks or threads.

use crate::blocks::Blocks;
use crate::exact;
use crate::member::{Member, by_place, grouped, motors_of};
use crate::membrane::equation::Membrane;
use crate::membrane::silence::Bound;
use crate::method::{Integrator, Keep, MAX_SPIKES, Method, MethodError, Options, Stepping};
use crate::sampler::TILE;
use crate::scene::Scene;
use crate::simd::LANES;
use crate::stepped::{self, Block, StepModel};
use crate::time::end;
use crate::track::{Column, Track, Tracks};
use meissner_array::per_motor::PerMotor;
use pulp::Arch;
use rayon::prelude::*;
use std::sync::Arc;

/// What a simulation skipped. The answer is the same as without skipping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Skipped {
    /// Motors without a stroke: their input is 0.
    pub motors_at_rest: u32,
    /// Motors whose weight counts as 0 at every afferent.
    pub motors_out_of_reach: u32,
    /// Afferents that no moving motor reaches: the membrane stays at rest, below the lowest threshold.
    pub afferents_out_of_reach: u64,
    /// Afferents whose input stays below their first threshold, even if no parts of it cancel.
    pub afferents_below_threshold: u64,
}

/// Afferents in a tile.
const TILE_AFFERENTS: usize = 4096;
/// The search for silent afferents looks at this many breakpoints of each motor, in turn. Eight strokes are often enough.
const SILENCE_BREAKPOINTS: [usize; 3] = [64, 4096, usize::MAX];
/// Steps in a block.
const STEPS: u64 = 256 * TILE as u64;

/// An afferent's number, its number of spikes, and their times, half ticks, if they are kept.
pub(crate) type Train = (u32, u64, Vec<f64>);
/// Receives the spike train of an afferent. As a trait object, so that the simulation is compiled only once.
pub(crate) type Give<'g> = dyn FnMut(Train) + 'g;

/// Simulates some of a scene's afferents with the vectors of an architecture. `give` is called with the spike
/// train of each, in no particular order.
pub(crate) fn run(
    arch: Arch,
    scene: &Scene,
    tracks: &Tracks,
    numbers: &[u32],
    options: &Options,
    progress: &(dyn Fn(f64) + Sync),
    give: &mut Give<'_>,
) -> Result<Skipped, MethodError> {
    let work = Work { arch, ..Work::new(scene, options, tracks, &[]) };
    work.run(&by_place(scene, numbers), progress, give)
}

pub(crate) struct Work<'w> {
    scene: &'w Scene,
    options: &'w Options,
    arch: Arch,
    membrane: Membrane,
    end: f64,
    tracks: PerMotor<Option<&'w Track>>,
    /// The motors that have a track, one bit each.
    moving: u64,
    /// The members with their weights of all motors, indexed by their numbers; empty if they are made for each run.
    kept: &'w [Member],
}

impl<'w> Work<'w> {
    pub(crate) fn new(
        scene: &'w Scene,
        options: &'w Options,
        tracks: &'w Tracks,
        kept: &'w [Member],
    ) -> Self {
        let array = scene.array();
        let (membrane, end) = (Membrane::of(scene.model(), &array), end(scene.duration_s(), array.rate()));
        let tracks = PerMotor::from_fn(array, |motor| tracks[usize::from(motor)].as_deref());
        Self { scene, options, arch: Arch::new(), membrane, end, tracks, moving: 0, kept }.counted()
    }

    /// The same work with other tracks of some motors.
    pub(crate) fn with(mut self, tracks: &'w [(u8, Option<Arc<Track>>)]) -> Self {
        tracks.iter().for_each(|(motor, track)| self.tracks[usize::from(*motor)] = track.as_deref());
        self.counted()
    }

    fn counted(self) -> Self {
        let moving = self.tracks.iter().flatten().fold(0, |moving, track| moving | 1_u64 << track.motor());
        Self { moving, ..self }
    }

    /// Simulates some afferents, which must be in order of place.
    pub(crate) fn run(
        &self,
        order: &[u32],
        progress: &(dyn Fn(f64) + Sync),
        give: &mut Give<'_>,
    ) -> Result<Skipped, MethodError> {
        let motors_at_rest = self.tracks.len() as u32 - self.moving.count_ones();
        let mut skipped = Skipped { motors_at_rest, ..Skipped::default() };
        let (mut reaching, mut kept) = (0, 0);
        let tiles = order.len().div_ceil(TILE_AFFERENTS).max(1) as f64;
        for (index, tile) in order.chunks(TILE_AFFERENTS).enumerate() {
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

    /// Simulates a tile and returns the motors that reach it, one bit each.
    fn tile(
        &self,
        numbers: &[u32],
        skipped: &mut Skipped,
        progress: &(dyn Fn(f64) + Sync),
        give: &mut Give<'_>,
    ) -> Result<u64, MethodError> {
        let mut members: Vec<_> =
            numbers.par_iter().with_min_len(64).map(|&number| self.member(number)).collect();
        let reaching = motors_of(&members);
        if self.options.skip {
            members.retain(|member| {
                let reached = member.motors != 0;
                if !reached {
                    skipped.afferents_out_of_reach += 1;
                    give((member.number, 0, Vec::new()));
                }
                reached
            });
            let silent = self.silent(&mut members);
            skipped.afferents_below_threshold += silent.len() as u64;
            silent.into_iter().for_each(|number| give((number, 0, Vec::new())));
        }
        match self.options.method {
            Method::Exact => self.exact(members, progress, give)?,
            Method::Stepped(stepping) => self.stepped(stepping, members, progress, give)?,
        }
        Ok(reaching)
    }

    /// An afferent, with its weights of the motors that move.
    fn member(&self, number: u32) -> Member {
        let Some(kept) = self.kept.get(number as usize) else {
            return Member::new(self.scene, self.options, &self.membrane, number, self.moving);
        };
        Member { motors: kept.motors & self.moving, ..kept.clone() }
    }

    /// Takes out the members that cannot reach their threshold, and returns their numbers.
    fn silent(&self, members: &mut Vec<Member>) -> Vec<u32> {
        let step = match self.options.method {
            Method::Exact => 0.0,
            Method::Stepped(stepping @ Stepping { integrator: Integrator::Propagator, .. }) => {
                stepping.half_ticks(self.scene.array().rate())
            }
            // Euler's method samples the input, so an integral of the input gives no bound.
            Method::Stepped(_) => return Vec::new(),
        };
        let bound = Bound::new(&self.membrane, step);
        let mut silent: Vec<usize> = (0..members.len()).collect();
        // A member that may fire needs no further bound. After a few strokes of each motor that is often all of them.
        for breakpoints in SILENCE_BREAKPOINTS {
            if silent.is_empty() {
                break;
            }
            let motors = silent.iter().fold(0, |motors, &index| motors | members[index].motors);
            let charge =
                |track: &Option<&Track>| track.map_or(0.0, |track| track.charge(&bound, breakpoints));
            let charges: Vec<f64> = self.tracks_of(motors).par_iter().with_min_len(4).map(charge).collect();
            silent.retain(|&index| {
                let member = &members[index];
                !bound.reaches(&charges, member.reached_by(), member.threshold())
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

    /// The tracks of some motors, given as one bit each.
    fn tracks_of(&self, motors: u64) -> PerMotor<Option<&'w Track>> {
        let array = self.scene.array();
        PerMotor::from_fn(array, |motor| self.tracks[usize::from(motor)].filter(|_| motors >> motor & 1 == 1))
    }

    /// Simulates members exactly.
    fn exact(
        &self,
        members: Vec<Member>,
        progress: &(dyn Fn(f64) + Sync),
        give: &mut Give<'_>,
    ) -> Result<(), MethodError> {
        if members.is_empty() {
            return Ok(());
        }
        let tracks = self.tracks_of(motors_of(&members));
        let array = self.scene.array();
        let mut blocks = Blocks::new(&array, tracks.iter().copied().flatten(), self.end);
        let keep = self.options.keep == Keep::Spikes;
        let (numbers, mut groups): (Vec<_>, Vec<_>) = grouped(members, LANES)
            .map(|(numbers, members)| (numbers, exact::Group::new(&array, members, &self.membrane, self.end)))
            .unzip();
        let mut block = Vec::new();
        while blocks.next_into(&mut block) {
            groups.par_iter_mut().for_each(|group| group.run(self.arch, &self.membrane, &block, keep));
            progress(blocks.reached() / self.end);
            within_bounds(groups.iter().map(exact::Group::kept).sum())?;
        }
        let trains: Vec<_> =
            groups.into_par_iter().map(|group| group.finish(self.arch, &self.membrane, keep)).collect();
        give_all(numbers, trains, give);
        Ok(())
    }

    fn stepped(
        &self,
        stepping: Stepping,
        members: Vec<Member>,
        progress: &(dyn Fn(f64) + Sync),
        give: &mut Give<'_>,
    ) -> Result<(), MethodError> {
        let length = stepping.half_ticks(self.scene.array().rate());
        let model = StepModel::new(&self.membrane, stepping.integrator, length);
        let tracks = self.tracks_of(motors_of(&members));
        let (numbers, mut groups): (Vec<_>, Vec<_>) = grouped(members, LANES)
            .map(|(numbers, members)| (numbers, stepped::Group::new(tracks.len(), members)))
            .unzip();
        // The samples are a tenth of the work: make them in parallel, too.
        let column = |track: &Option<&'w Track>| track.and_then(Column::of);
        let mut columns: Vec<_> = tracks.par_iter().with_min_len(4).map(column).collect();
        let steps = (self.end / length).ceil() as u64;
        let mut first = 0;
        while first < steps && !groups.is_empty() {
            let count = (steps - first).min(STEPS);
            columns.par_iter_mut().flatten().for_each(|column| column.go_to(first, count as usize));
            let inputs = columns.iter().map(|column| column.as_ref().map_or(&[][..], Column::now));
            let inputs: Vec<&[f64]> = inputs.collect();
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
        give_all(numbers, groups.into_iter().map(stepped::Group::into_trains), give);
        Ok(())
    }
}

/// Gives the trains of groups, with the numbers of their afferents.
fn give_all<T: IntoIterator<Item = (u64, Vec<f64>)>>(
    numbers: Vec<Vec<u32>>,
    groups: impl IntoIterator<Item = T>,
    give: &mut Give<'_>,
) {
    for (numbers, trains) in numbers.into_iter().zip(groups) {
        numbers.into_iter().zip(trains).for_each(|(number, (count, spikes))| give((number, count, spikes)));
    }
}

/// Checks that so many spikes can be kept.
fn within_bounds(spikes: u64) -> Result<(), MethodError> {
    if spikes > MAX_SPIKES { Err(MethodError::TooManySpikes) } else { Ok(()) }
}
