//! The cost of a point, by simulation, and that of points near it for less.
//!
//! The receptors of one population or of several are one scene, each with noise of its own, so that the cost is a mean
//! over populations. Every point meets the same receptors and the same noise: what differs between two costs is what
//! the motors do. Spikes are counted in whole numbers and added up first, so that the cost does not depend on any order.
//!
//! Invariant: a [`Standing`]'s score is that of its point, whichever way it was reached.

use super::{Frame, Partition, Point, Target};
use meissner_array::pattern::Drive;
use meissner_skin::afferent::{self, MIN_WEIGHT, Position};
use meissner_skin::{
    Candidate, Evaluator, Integrator, Method, MethodError, Options, Precision, Scene, Stepping,
};
use rayon::prelude::*;

/// How well a cost is simulated: what a search may do with less.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fidelity {
    /// How long is watched.
    pub duration_s: f64,
    /// By the propagator with this step; without, by the exact method.
    pub step_us: Option<u32>,
    /// Weights below this count as 0.
    pub min_weight: f64,
}

impl Fidelity {
    /// The model's own: a second, exactly.
    pub const FULL: Self = Self { duration_s: 1.0, step_us: None, min_weight: MIN_WEIGHT };

    fn options(self) -> Options {
        let stepping =
            |step_us| Stepping { step_us, integrator: Integrator::Propagator, precision: Precision::F32 };
        let method = self.step_us.map_or(Method::Exact, |step_us| Method::Stepped(stepping(step_us)));
        Options { min_weight: self.min_weight, ..Options::rates(method) }
    }
}

/// Mean rates, impulses/s, over the populations that have receptors of both kinds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Of the receptors within reach.
    pub on_hz: f64,
    /// Of the others.
    pub off_hz: f64,
}

impl Score {
    /// The cost: the higher, the better.
    #[must_use]
    pub fn cost_hz(self) -> f64 {
        self.on_hz - self.off_hz
    }
}

/// What is to be felt and by whom.
#[derive(Clone, Debug)]
pub struct Objective {
    /// With its receptors, and without drives.
    scene: Scene,
    options: Options,
    amplitude_um: f64,
    /// From when to when a point is played: once and for ever, or for a frame's time again and again.
    times: Vec<(Option<f64>, Option<f64>)>,
    /// Of each receptor: its population, and whether it is within reach.
    kinds: Vec<(usize, bool)>,
    /// Of each population: how many are OFF and ON.
    counts: Vec<[usize; 2]>,
}

impl Objective {
    /// The cost of a frame for the populations of some seeds; those without receptors of both kinds are left out.
    /// `noise_seed` keys the thresholds. A frame that ends is repeated: what its end costs, because a stroke that does not
    /// fit into it is not played, is part of the cost.
    ///
    /// # Panics
    /// If the fidelity's duration is none that a scene can have.
    #[must_use]
    pub fn new(
        target: &Target,
        frame: &Frame,
        populations: &[u64],
        noise_seed: u64,
        fidelity: Fidelity,
    ) -> Self {
        let (mut receptors, mut kinds, mut counts) = (Vec::<Position>::new(), Vec::new(), Vec::new());
        for &seed in populations {
            let places = afferent::population(seed);
            let partition = Partition::of(&frame.shape, target.reach_mm(), &places);
            if partition.on_count() > 0 && partition.off_count() > 0 {
                kinds.extend(partition.on().iter().map(|&on| (counts.len(), on)));
                counts.push([partition.off_count(), partition.on_count()]);
                receptors.extend(places);
            }
        }
        let scene = Scene::new(fidelity.duration_s, noise_seed, Vec::new(), receptors, *target.model());
        let scene = scene.expect("a checked target is made of what a scene is made of");
        let times = match frame.start_s.zip(frame.stop_s) {
            None => vec![(None, None)],
            Some((start_s, stop_s)) => {
                let begins = |number: u32| (stop_s - start_s) * f64::from(number);
                let numbers = (0..).take_while(|&number| begins(number) < fidelity.duration_s);
                numbers.map(|number| (Some(begins(number)), Some(begins(number + 1)))).collect()
            }
        };
        let (options, amplitude_um) = (fidelity.options(), target.amplitude_um());
        Self { scene, options, amplitude_um, times, kinds, counts }
    }

    /// Simulates a point as a whole.
    ///
    /// # Errors
    /// If the method cannot simulate the target's receptors.
    pub fn at(&self, point: Point) -> Result<Standing<'_>, MethodError> {
        let scene = self.scene.with_drives(self.drives(&point));
        let scene = scene.expect("a space has no drives that a scene has not");
        let evaluator = Evaluator::new(scene, self.options)?;
        Ok(Standing { objective: self, point, score: self.score(evaluator.counts()), evaluator })
    }

    /// Receptors of all populations.
    #[must_use]
    pub fn receptors(&self) -> usize {
        self.kinds.len()
    }

    /// How long is watched.
    #[must_use]
    pub const fn duration_s(&self) -> f64 {
        self.scene.duration_s()
    }

    fn drives(&self, point: &Point) -> Vec<Drive> {
        let played = |&(start_s, stop_s)| point.drives(self.amplitude_um, start_s, stop_s);
        self.times.iter().flat_map(played).collect()
    }

    fn score(&self, counts: &[u64]) -> Score {
        let mut spikes = vec![[0_u64; 2]; self.counts.len()];
        for (&(population, on), count) in self.kinds.iter().zip(counts) {
            spikes[population][usize::from(on)] += count;
        }
        let mean = |side: usize| {
            let rates =
                spikes.iter().zip(&self.counts).map(|(spikes, of)| spikes[side] as f64 / of[side] as f64);
            rates.sum::<f64>() / (self.counts.len().max(1) as f64 * self.duration_s())
        };
        Score { on_hz: mean(1), off_hz: mean(0) }
    }
}

/// A point and its score.
#[derive(Clone, Debug)]
pub struct Standing<'o> {
    objective: &'o Objective,
    point: Point,
    score: Score,
    evaluator: Evaluator,
}

/// Another point and its score.
#[derive(Clone, Debug)]
pub struct Tried {
    /// Where.
    pub point: Point,
    /// What it comes to.
    pub score: Score,
    /// Receptors that were simulated for it.
    pub receptors: usize,
    trial: Candidate,
}

impl<'o> Standing<'o> {
    /// Where it stands.
    #[must_use]
    pub const fn point(&self) -> &Point {
        &self.point
    }

    /// What that comes to.
    #[must_use]
    pub const fn score(&self) -> Score {
        self.score
    }

    /// What it stands on.
    #[must_use]
    pub const fn objective(&self) -> &'o Objective {
        self.objective
    }

    /// Tries other points, on as many threads as there are.
    #[must_use]
    pub fn try_all(&self, points: Vec<Point>) -> Vec<Tried> {
        let tried = |point: Point| {
            let trial = self
                .evaluator
                .evaluate(&self.objective.drives(&point))
                .expect("a space has no drives that a scene has not");
            Tried { point, score: self.objective.score(&trial.counts()), receptors: trial.simulated(), trial }
        };
        points.into_par_iter().map(tried).collect()
    }

    /// Goes there.
    pub fn go(&mut self, tried: Tried) {
        (self.point, self.score) = (tried.point, tried.score);
        self.evaluator.accept(tried.trial);
    }
}
