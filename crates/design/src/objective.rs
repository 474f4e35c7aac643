//! The objective: simulates the value of a [`Goal`] at a point, and at nearby points with less work.
//!
//! The afferents of all populations are one scene, each with its own noise; the value is a mean over populations. Every point is
//! simulated with the same afferents and the same noise, so two values differ only by the motors' drives. Spikes are counted in
//! whole numbers and summed first.
//!
//! Under the second model the afferents are its RA afferents, at the same places as those of the first. A fidelity with a
//! `min_share` simulates them approximately ([`NearEvaluator`]), for a search; its scores cannot be compared with those of the full
//! model.
//!
//! Invariant: the score of an [`Incumbent`] is that of its point, however it was reached.

use crate::goal::{Goal, Population};
use crate::point::Point;
use crate::shape::Shape;
use crate::target::{Frame, Target};
use meissner_array::pattern::Drive;
use meissner_skin::afferents::{self, Class, NearCandidate, NearEvaluator};
use meissner_skin::membrane::{self, MIN_WEIGHT, Position};
use meissner_skin::{
    Candidate, Evaluator, Integrator, Keep, Method, MethodError, ModelName, Options, Precision, Scene,
    Stepping,
};
use rayon::prelude::*;
use std::sync::Arc;

const EVERY_DRIVE: &str = "a scene can have every drive of a space";

/// How accurately a value is simulated: a search begins with a low fidelity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fidelity {
    /// Duration of the simulation, s.
    pub duration_s: f64,
    /// The step of the propagator; none simulates exactly. The second model has its own step.
    pub step_us: Option<u32>,
    /// Weights below this count as 0; for the first model only.
    pub min_weight: f64,
    /// For the second model: simulate approximately, and count a motor's influence below this share of the largest as 0. None
    /// simulates the full model; so does, always, an amplitude that may lift pins off the skin.
    pub min_share: Option<f64>,
}

impl Fidelity {
    /// One second, by the finest method.
    pub const FULL: Self = Self { duration_s: 1.0, step_us: None, min_weight: MIN_WEIGHT, min_share: None };

    fn options(self) -> Options {
        let stepping =
            |step_us| Stepping { step_us, integrator: Integrator::Propagator, precision: Precision::F32 };
        let method = self.step_us.map_or(Method::Exact, |step_us| Method::Stepped(stepping(step_us)));
        Options { min_weight: self.min_weight, ..Options::rates(method) }
    }
}

/// Mean rates over the populations that have ON and OFF afferents, impulses/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    /// Of the ON afferents.
    pub on_hz: f64,
    /// Of the OFF afferents.
    pub off_hz: f64,
    /// The value of the goal; higher is better.
    pub value: f64,
}

impl Score {
    /// The contrast.
    #[must_use]
    pub fn cost_hz(self) -> f64 {
        self.on_hz - self.off_hz
    }
}

/// The afferents of all populations, under one model.
#[derive(Clone, Debug)]
enum Afferents {
    /// A scene without drives.
    Membrane(Box<Scene>, Options),
    /// A scene of the second model, without drives.
    Second(Arc<afferents::Scene>),
    /// The same, simulated approximately.
    Near(Box<NearEvaluator>),
}

/// The value of a goal for a frame under one model, as a function of the point.
#[derive(Clone, Debug)]
pub struct Objective {
    afferents: Arc<Afferents>,
    duration_s: f64,
    amplitude_um: f64,
    /// The start and end times of a point's drives: one drive without end, or repeats of the frame's duration.
    times: Vec<(Option<f64>, Option<f64>)>,
    goal: Goal,
    populations: Arc<Populations>,
}

/// The populations of a scene, one after the other in the order of its afferents: each with its number of afferents, and what the
/// goal knows of it. A population without ON or without OFF afferents is none, and does not count.
#[derive(Clone, Debug)]
pub(crate) struct Populations(Vec<(usize, Option<Population>)>);

impl Populations {
    /// The populations at these places, for a target's shape where it is.
    pub(crate) fn new(goal: Goal, target: &Target, shape: &Shape, places: &[Vec<Position>]) -> Self {
        let (reach_mm, pitch_mm) = (target.reach_mm(), target.array().pitch_mm());
        let of =
            |places: &Vec<Position>| (places.len(), Population::new(goal, shape, reach_mm, pitch_mm, places));
        Self(places.iter().map(of).collect())
    }
}

/// A goal for a frame, over the populations of some seeds. `noise_seed` seeds the threshold noise.
#[derive(Clone, Copy, Debug)]
pub struct Task<'t> {
    /// The goal to maximise.
    pub goal: Goal,
    /// The target: its array, reach, amplitude and afferent model.
    pub target: &'t Target,
    /// One of its frames.
    pub frame: &'t Frame,
    /// Seeds of the populations over which the value is the mean.
    pub populations: &'t [u64],
    /// Seed of the threshold noise.
    pub noise_seed: u64,
}

impl Objective {
    /// A goal for a frame under the first model, over the populations of some seeds; those without ON or OFF afferents are left
    /// out. `noise_seed` seeds the threshold noise. A frame with an end is repeated, so the value accounts for the strokes that the
    /// end cuts off.
    ///
    /// # Panics
    /// If no scene can have the fidelity's duration.
    #[must_use]
    pub fn new(
        goal: Goal,
        target: &Target,
        frame: &Frame,
        populations: &[u64],
        noise_seed: u64,
        fidelity: Fidelity,
    ) -> Self {
        let task = Task { goal, target, frame, populations, noise_seed };
        Self::under(ModelName::Membrane, task, fidelity)
    }

    /// The same under either model.
    ///
    /// # Panics
    /// If no scene can have the fidelity's duration.
    #[must_use]
    pub fn under(model: ModelName, task: Task<'_>, fidelity: Fidelity) -> Self {
        let places: Vec<_> = task.populations.iter().map(|&seed| membrane::population(seed)).collect();
        let Populations(of) = Populations::new(task.goal, task.target, &task.frame.shape, &places);
        let kept = task.populations.iter().zip(of).filter(|(_, (_, population))| population.is_some());
        let (seeds, kept): (Vec<u64>, _) = kept.unzip();
        Self::over(model, Task { populations: &seeds, ..task }, Populations(kept), fidelity)
    }

    fn over(model: ModelName, task: Task<'_>, kept: Populations, fidelity: Fidelity) -> Self {
        let Task { goal, target, frame, populations: seeds, noise_seed } = task;
        let (array, duration_s) = (target.array(), fidelity.duration_s);
        let afferents = match model {
            ModelName::Membrane => {
                let afferents: Vec<Position> =
                    seeds.iter().flat_map(|&seed| membrane::population(seed)).collect();
                let scene = Scene::new(array, duration_s, noise_seed, Vec::new(), afferents, *target.model());
                let scene = scene.expect("the parts of a checked target make a scene");
                Afferents::Membrane(Box::new(scene), fidelity.options())
            }
            ModelName::Afferents => {
                let all = seeds.iter().flat_map(|&seed| afferents::population(seed));
                let rapid = all.filter(|afferent| afferent.class == Class::Ra).collect();
                let motors =
                    Scene::new(array, duration_s, noise_seed, Vec::new(), Vec::new(), *target.model());
                let scene = motors.and_then(|motors| {
                    afferents::Scene::of_motors(&motors, afferents::PREINDENT_MM, rapid, true)
                });
                let scene = scene.expect("populations make a scene");
                let near = fidelity
                    .min_share
                    .and_then(|min_share| NearEvaluator::new(&scene, target.amplitude_um(), min_share));
                near.map_or_else(
                    || Afferents::Second(Arc::new(scene)),
                    |near| Afferents::Near(Box::new(near)),
                )
            }
        };
        let times = match frame.start_s.zip(frame.stop_s) {
            None => vec![(None, None)],
            Some((start_s, stop_s)) => {
                let begins = |number: u32| (stop_s - start_s) * f64::from(number);
                let numbers = (0..).take_while(|&number| begins(number) < fidelity.duration_s);
                numbers.map(|number| (Some(begins(number)), Some(begins(number + 1)))).collect()
            }
        };
        let amplitude_um = target.amplitude_um();
        let (afferents, populations) = (Arc::new(afferents), Arc::new(kept));
        Self { afferents, duration_s, amplitude_um, times, goal, populations }
    }

    /// Simulates a point with all afferents.
    ///
    /// # Errors
    /// If the method cannot simulate the target's afferents.
    pub fn at(&self, point: Point) -> Result<Incumbent<'_>, MethodError> {
        let drives = self.drives(&point);
        let simulated = match &*self.afferents {
            Afferents::Membrane(scene, options) => {
                let evaluator = Evaluator::new(scene.with_drives(drives).expect(EVERY_DRIVE), *options)?;
                Simulated::Membrane(Box::new(evaluator))
            }
            Afferents::Second(scene) => Simulated::Second(Arc::clone(scene), counts(scene, drives)),
            Afferents::Near(at_rest) => {
                let mut evaluator = at_rest.clone();
                evaluator.accept(evaluator.evaluate(&drives).expect(EVERY_DRIVE));
                Simulated::Near(evaluator)
            }
        };
        let score = self.score(simulated.counts());
        Ok(Incumbent { objective: self, point, score, simulated })
    }

    /// The number of afferents in all populations.
    #[must_use]
    pub fn afferents(&self) -> usize {
        match &*self.afferents {
            Afferents::Membrane(scene, _) => scene.afferents().len(),
            Afferents::Second(scene) => scene.afferents().len(),
            Afferents::Near(evaluator) => evaluator.counts().len(),
        }
    }

    /// Duration of the simulation, s.
    #[must_use]
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    fn drives(&self, point: &Point) -> Vec<Drive> {
        let played = |&(start_s, stop_s)| point.drives(self.amplitude_um, start_s, stop_s);
        self.times.iter().flat_map(played).collect()
    }

    /// The score of counts, one for each afferent.
    pub(crate) fn score(&self, mut counts: &[u64]) -> Score {
        let (mut sum, mut counting) = (Score::default(), 0_u32);
        let duration_s = self.duration_s();
        for (afferents, population) in &self.populations.0 {
            let (own, rest) = counts.split_at(*afferents);
            counts = rest;
            let Some(population) = population else { continue };
            counting += 1;
            let partition = population.partition();
            let [off, on] = population.sums(own);
            sum.on_hz += on as f64 / partition.on_count() as f64;
            sum.off_hz += off as f64 / partition.off_count() as f64;
            if self.goal != Goal::Contrast {
                sum.value += population.value(self.goal, own, duration_s);
            }
        }
        let count = f64::from(counting.max(1));
        let (on_hz, off_hz) = (sum.on_hz / (count * duration_s), sum.off_hz / (count * duration_s));
        // The contrast of the means: a mean of contrasts would differ by rounding.
        let value = if self.goal == Goal::Contrast { on_hz - off_hz } else { sum.value / count };
        Score { on_hz, off_hz, value }
    }
}

/// The counts of the second model for some drives.
fn counts(scene: &afferents::Scene, drives: Vec<Drive>) -> Vec<u64> {
    let scene = scene.with_drives(drives).expect(EVERY_DRIVE);
    let answer = afferents::simulate(&scene, Keep::Rates, &|_| ());
    answer.expect("no spikes are kept, so there are never too many").counts
}

/// How points near an incumbent are simulated.
#[derive(Clone, Debug)]
enum Simulated {
    /// Keeps the part of the incumbent's answer that does not change.
    Membrane(Box<Evaluator>),
    /// Simulates each point from scratch: every pin moves the skin under all others, so no part of an answer holds for another
    /// point. The counts are the incumbent's.
    Second(Arc<afferents::Scene>, Vec<u64>),
    /// As for the first model; small influences are ignored.
    Near(Box<NearEvaluator>),
}

impl Simulated {
    fn counts(&self) -> &[u64] {
        match self {
            Self::Membrane(evaluator) => evaluator.counts(),
            Self::Second(_, counts) => counts,
            Self::Near(evaluator) => evaluator.counts(),
        }
    }
}

/// The part of an answer that differs from the incumbent's.
#[derive(Clone, Debug)]
enum Differing {
    Membrane(Box<Candidate>),
    /// All counts.
    Second(Vec<u64>),
    Near(Box<NearCandidate>),
}

/// A point with its score, from which nearby points are simulated for less work.
#[derive(Clone, Debug)]
pub struct Incumbent<'o> {
    objective: &'o Objective,
    point: Point,
    score: Score,
    simulated: Simulated,
}

/// Another point, with its score.
#[derive(Clone, Debug)]
pub struct Tried {
    /// The point.
    pub point: Point,
    /// Its score.
    pub score: Score,
    /// The number of afferents that were simulated for it.
    pub afferents: usize,
    differing: Differing,
}

impl Incumbent<'_> {
    /// The point.
    #[must_use]
    pub const fn point(&self) -> &Point {
        &self.point
    }

    /// Its score.
    #[must_use]
    pub const fn score(&self) -> Score {
        self.score
    }

    /// Scores other points in parallel. Under the first model only the afferents that a changed motor reaches are simulated.
    #[must_use]
    pub fn try_all(&self, points: Vec<Point>) -> Vec<Tried> {
        let tried = |point: Point| {
            let drives = self.objective.drives(&point);
            let (counts, afferents, differing) = match &self.simulated {
                Simulated::Membrane(evaluator) => {
                    let candidate = evaluator.evaluate(&drives).expect(EVERY_DRIVE);
                    (candidate.counts(), candidate.simulated(), Differing::Membrane(Box::new(candidate)))
                }
                Simulated::Second(scene, _) => {
                    let counts = counts(scene, drives);
                    (counts.clone(), scene.afferents().len(), Differing::Second(counts))
                }
                Simulated::Near(evaluator) => {
                    let candidate = evaluator.evaluate(&drives).expect(EVERY_DRIVE);
                    (candidate.counts(), candidate.simulated(), Differing::Near(Box::new(candidate)))
                }
            };
            Tried { point, score: self.objective.score(&counts), afferents, differing }
        };
        points.into_par_iter().map(tried).collect()
    }

    /// Makes a tried point the incumbent.
    pub fn move_to(&mut self, tried: Tried) {
        (self.point, self.score) = (tried.point, tried.score);
        match (&mut self.simulated, tried.differing) {
            (Simulated::Membrane(evaluator), Differing::Membrane(candidate)) => evaluator.accept(*candidate),
            (Simulated::Near(evaluator), Differing::Near(candidate)) => evaluator.accept(*candidate),
            (Simulated::Second(_, own), Differing::Second(counts)) => *own = counts,
            _ => unreachable!("a point is tried as its incumbent is simulated"),
        }
    }
}
