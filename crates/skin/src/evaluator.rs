//! Evaluates a scene again and again while some of its motors change, as the optimiser does.
//!
//! A [`Candidate`] is the answer with other drives. Only the afferents that a changed motor reaches are simulated again. An
//! afferent's spikes depend only on the motors that reach it, so the kept answers of the others are those of a whole simulation,
//! bit by bit. Candidates do not change the evaluator: several threads may evaluate them on one [`Evaluator`], and accept one of
//! them or none.
//!
//! Invariant: [`Evaluator::counts`] is always the answer to [`Evaluator::scene`].

use crate::engine::Work;
use crate::member::{Member, by_place};
use crate::membrane::equation::Membrane;
use crate::method::{Keep, MethodError, Options};
use crate::scene::{Scene, SceneError};
use crate::track::{self, MAX_KEPT_BYTES, Track, Tracks};
use meissner_array::pattern::Drive;
use rayon::prelude::*;
use std::sync::Arc;

/// A scene and its answer.
#[derive(Clone, Debug)]
pub struct Evaluator {
    scene: Scene,
    options: Options,
    /// Shared with its candidates: the pointer identifies them.
    counts: Arc<Vec<u64>>,
    tracks: Tracks,
    afferents: Arc<Afferents>,
}

/// The part of the afferents that does not depend on the drives.
#[derive(Debug)]
struct Afferents {
    /// Their numbers in order of place, each with the motors that reach it, one bit each.
    order: Vec<(u32, u64)>,
    /// Indexed by their numbers; empty if they would take too much memory.
    members: Vec<Member>,
}

/// An [`Evaluator`]'s scene with other drives, and the part of the answer that changes.
#[derive(Clone, Debug)]
#[must_use]
pub struct Candidate {
    scene: Scene,
    /// The counts of the scene it was made from.
    from: Arc<Vec<u64>>,
    /// Those of the changed motors.
    tracks: Vec<(u8, Option<Arc<Track>>)>,
    changed: Vec<(u32, u64)>,
}

impl Evaluator {
    /// Simulates a scene for the first time. It keeps only counts, and ignores what `options` say about that.
    ///
    /// # Errors
    /// If the method cannot simulate the scene.
    pub fn new(scene: Scene, options: Options) -> Result<Self, MethodError> {
        let options = Options { keep: Keep::Rates, ..options };
        options.method.check(&scene)?;
        let tracks = track::of_scene(&scene, options.method);
        let afferents = Arc::new(Afferents::new(&scene, &options));
        let work = Work::new(&scene, &options, &tracks, &afferents.members);
        let numbers: Vec<_> = afferents.order.iter().map(|&(number, _)| number).collect();
        let mut counts = vec![0; numbers.len()];
        work.run(&numbers, &|_| (), &mut |(number, count, _)| counts[number as usize] = count)?;
        Ok(Self { scene, options, counts: Arc::new(counts), tracks, afferents })
    }

    /// Evaluates the scene with these drives in place of its own.
    ///
    /// # Errors
    /// If the drives are not those of a scene.
    pub fn evaluate(&self, drives: &[Drive]) -> Result<Candidate, SceneError> {
        Ok(self.candidate(self.scene.with_drives(drives.to_vec())?))
    }

    /// Makes a candidate's scene the scene.
    ///
    /// # Panics
    /// If the candidate was made from another scene.
    pub fn accept(&mut self, candidate: Candidate) {
        let Candidate { scene, from, tracks, changed } = candidate;
        assert!(Arc::ptr_eq(&from, &self.counts), "a candidate is accepted before the scene changes");
        self.scene = scene;
        tracks.into_iter().for_each(|(motor, track)| self.tracks[usize::from(motor)] = track);
        // Drop the second owner, so that `make_mut` copies nothing.
        drop(from);
        let counts = Arc::make_mut(&mut self.counts);
        changed.into_iter().for_each(|(number, count)| counts[number as usize] = count);
    }

    /// Evaluates a scene that differs in its drives alone.
    fn candidate(&self, scene: Scene) -> Candidate {
        let differs = |motor: &u8| {
            let of_motor = |drive: &&Drive| drive.motor == *motor;
            !self.scene.drives().iter().filter(of_motor).eq(scene.drives().iter().filter(of_motor))
        };
        let of_motor = |motor| {
            let (array, duration_s) = (scene.array(), scene.duration_s());
            Track::of_drives(array, motor, scene.drives(), duration_s, self.options.method).map(Arc::new)
        };
        let track = |motor| (motor, of_motor(motor));
        let tracks: Vec<_> = scene.array().numbers().filter(differs).map(track).collect();
        let differing = tracks.iter().fold(0, |motors, (motor, _)| motors | 1_u64 << motor);
        let reached = self.afferents.order.iter().filter(|(_, motors)| motors & differing != 0);
        let numbers: Vec<u32> = reached.map(|&(number, _)| number).collect();
        let mut changed = Vec::with_capacity(numbers.len());
        if !numbers.is_empty() {
            let work = Work::new(&scene, &self.options, &self.tracks, &self.afferents.members).with(&tracks);
            let ran = work.run(&numbers, &|_| (), &mut |(number, count, _)| changed.push((number, count)));
            ran.expect("no spikes are kept, so there are never too many");
        }
        Candidate { scene, from: Arc::clone(&self.counts), tracks, changed }
    }

    /// The current scene.
    pub const fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Each afferent's number of spikes.
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }
}

impl Afferents {
    fn new(scene: &Scene, options: &Options) -> Self {
        let membrane = Membrane::of(scene.model(), &scene.array());
        let numbers: Vec<_> = (0..scene.afferents().len() as u32).collect();
        let member = |number: u32| Member::new(scene, options, &membrane, number, u64::MAX);
        let with_motors = |number| (number, member(number).motors);
        let order = by_place(scene, &numbers).into_par_iter().with_min_len(64).map(with_motors).collect();
        let few = numbers.len() * (size_of::<Member>() + 8 * scene.array().motors()) <= MAX_KEPT_BYTES;
        let members =
            if few { numbers.into_par_iter().with_min_len(64).map(member).collect() } else { Vec::new() };
        Self { order, members }
    }
}

impl Candidate {
    /// The number of afferents that were simulated.
    pub fn simulated(&self) -> usize {
        self.changed.len()
    }

    /// Each afferent's number of spikes, simulated or not.
    pub fn counts(&self) -> Vec<u64> {
        let mut counts = Vec::clone(&self.from);
        self.changed.iter().for_each(|&(number, count)| counts[number as usize] = count);
        counts
    }
}
