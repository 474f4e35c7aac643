//! A scene evaluated again and again with some of its motors changed: the optimiser's case.
//!
//! A [`Trial`] is what the scene would come to with other drives. Only the receptors that feel a motor whose drives
//! differ are simulated again. What a receptor does depends on nothing but the motors that reach it, so the others'
//! answers are what a whole simulation would give, bit by bit. Trials change nothing: several threads may make them of
//! one evaluator, and one of them, or none, is accepted.
//!
//! Invariant: [`Evaluator::counts`] is always the answer to [`Evaluator::scene`].

use super::engine::{self, Member, Work};
use super::track::{self, MOST_KEPT, Track, Tracks};
use super::{Keep, MethodError, Options, Scene, SceneError, Skipped, rate_hz};
use firmware_protocol::stroke::MOTORS;
use meissner_array::pattern::Drive;
use rayon::prelude::*;
use std::sync::Arc;

/// A scene and the answer to it.
#[derive(Clone, Debug)]
pub struct Evaluator {
    scene: Scene,
    options: Options,
    /// Shared with the trials made of it, by which they are known.
    counts: Arc<Vec<u64>>,
    tracks: Tracks,
    finger: Arc<Finger>,
}

/// What is known of the receptors whatever the motors do.
#[derive(Debug)]
struct Finger {
    /// In order of place, each with the motors it feels, a bit each.
    order: Vec<(u32, u32)>,
    /// At their numbers; empty if they would take too much memory.
    members: Vec<Member>,
}

/// A scene with other drives than an [`Evaluator`]'s, and what of the answer that changes.
#[derive(Clone, Debug)]
#[must_use]
pub struct Trial {
    scene: Scene,
    /// The counts of the scene it was made of.
    from: Arc<Vec<u64>>,
    /// The motors that changed.
    tracks: Vec<(u8, Option<Arc<Track>>)>,
    changed: Vec<(u32, u64)>,
    skipped: Skipped,
}

impl Evaluator {
    /// Simulates a scene for the first time. Spikes are not kept, whatever `options` say.
    ///
    /// # Errors
    /// If the method cannot simulate the scene.
    pub fn new(scene: Scene, options: Options) -> Result<Self, MethodError> {
        let options = Options { keep: Keep::Rates, ..options };
        options.method.check(&scene)?;
        let tracks = track::of_scene(&scene, options.method);
        let finger = Arc::new(Finger::new(&scene, &options, &tracks));
        let work = Work::new(&scene, &options, &tracks, &finger.members);
        let numbers: Vec<_> = finger.order.iter().map(|&(number, _)| number).collect();
        let mut counts = vec![0; numbers.len()];
        work.run(&numbers, &|_| (), &mut |(number, count, _)| counts[number as usize] = count)?;
        Ok(Self { scene, options, counts: Arc::new(counts), tracks, finger })
    }

    /// What the scene would come to with these drives in place of all of its own.
    ///
    /// # Errors
    /// If the drives are not those of a scene.
    pub fn trial(&self, drives: &[Drive]) -> Result<Trial, SceneError> {
        Ok(self.tried(self.scene.with_drives(drives.to_vec())?))
    }

    /// Makes a trial's scene the scene. A trial that was not made of the scene as it is now is simulated again.
    pub fn accept(&mut self, trial: Trial) {
        let trial = if Arc::ptr_eq(&trial.from, &self.counts) {
            trial
        } else {
            // Its drives were checked, and whether they are a scene's depends on nothing else.
            let drives = trial.scene.drives().to_vec();
            self.tried(self.scene.with_drives(drives).expect("the drives were checked"))
        };
        let Trial { scene, from, tracks, changed, .. } = trial;
        self.scene = scene;
        tracks.into_iter().for_each(|(motor, track)| self.tracks[usize::from(motor)] = track);
        // Nobody copies what nobody else has.
        drop(from);
        let counts = Arc::make_mut(&mut self.counts);
        changed.into_iter().for_each(|(number, count)| counts[number as usize] = count);
    }

    /// Replaces all drives of one motor, and simulates what that changes. Whatever motor `drives`
    /// name, they become this one's.
    ///
    /// # Errors
    /// If the drives are not those of a scene; then nothing changes.
    pub fn set_motor(&mut self, motor: u8, drives: &[Drive]) -> Result<Skipped, SceneError> {
        let trial = self.tried(self.scene.with_motor(motor, drives)?);
        let skipped = trial.skipped;
        self.accept(trial);
        Ok(skipped)
    }

    /// A trial of a scene that differs in its drives alone.
    fn tried(&self, scene: Scene) -> Trial {
        let differs = |motor: &u8| {
            let of_motor = |drive: &&Drive| drive.motor == *motor;
            !self.scene.drives().iter().filter(of_motor).eq(scene.drives().iter().filter(of_motor))
        };
        let track = |motor| (motor, Track::new(&scene, self.options.method, motor).map(Arc::new));
        let tracks: Vec<_> = (0..MOTORS as u8).filter(differs).map(track).collect();
        let differing = tracks.iter().fold(0, |motors, (motor, _)| motors | 1 << motor);
        let feeling = self.finger.order.iter().filter(|(_, feels)| feels & differing != 0);
        let receptors: Vec<u32> = feeling.map(|&(number, _)| number).collect();
        let mut changed = Vec::with_capacity(receptors.len());
        let mut skipped = Skipped::default();
        if !receptors.is_empty() {
            let work = Work::new(&scene, &self.options, &self.tracks, &self.finger.members).with(&tracks);
            let ran = work.run(&receptors, &|_| (), &mut |(number, count, _)| changed.push((number, count)));
            skipped = ran.expect("no spikes are kept, so there are never too many");
        }
        // They may reach the receptors that were not simulated.
        skipped.motors_out_of_reach = 0;
        skipped.receptors_reused = (self.counts.len() - receptors.len()) as u64;
        Trial { scene, from: Arc::clone(&self.counts), tracks, changed, skipped }
    }

    /// The scene as it is now.
    #[must_use]
    pub const fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Spikes of each receptor.
    #[must_use]
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Each receptor's impulses per second.
    #[must_use]
    pub fn rates_hz(&self) -> Vec<f64> {
        self.counts.iter().map(|&count| rate_hz(count, &self.scene)).collect()
    }
}

impl Finger {
    fn new(scene: &Scene, options: &Options, tracks: &Tracks) -> Self {
        let work = Work::new(scene, options, tracks, &[]);
        let numbers: Vec<_> = (0..scene.receptors().len() as u32).collect();
        let member = |number: u32| work.anew(number, |_| true);
        let feels = |number| (number, member(number).motors());
        let order = engine::by_place(scene, &numbers).into_par_iter().with_min_len(64).map(feels).collect();
        let few = numbers.len() * size_of::<Member>() <= MOST_KEPT;
        let members =
            if few { numbers.into_par_iter().with_min_len(64).map(member).collect() } else { Vec::new() };
        Self { order, members }
    }
}

impl Trial {
    /// The drives that were tried.
    #[must_use]
    pub fn drives(&self) -> &[Drive] {
        self.scene.drives()
    }

    /// How many receptors were simulated.
    #[must_use]
    pub fn simulated(&self) -> usize {
        self.changed.len()
    }

    /// Those receptors' numbers and spikes, in no particular order. Some may have as many as before.
    pub fn changed(&self) -> impl Iterator<Item = (u32, u64)> {
        self.changed.iter().copied()
    }

    /// Spikes of each receptor, of those that were not simulated, too.
    #[must_use]
    pub fn counts(&self) -> Vec<u64> {
        let mut counts = Vec::clone(&self.from);
        self.changed().for_each(|(number, count)| counts[number as usize] = count);
        counts
    }
}
