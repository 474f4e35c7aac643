//! The objective: simulates the contrast at a point, and at nearby points with less work.
//!
//! The afferents of all populations are one scene, each with its own noise; the contrast is that of the means over populations. Every point
//! is simulated with the same afferents and the same noise, so two contrasts differ only by the motors' drives. Spikes are counted in whole
//! numbers and summed first.
//!
//! Invariant: the score of an [`Incumbent`] is that of its point, however it was reached.

use crate::partition::Partition;
use crate::point::Point;
use crate::target::{Frame, Target};
use meissner_array::pattern::Drive;
use meissner_skin::membrane::{self, MIN_WEIGHT, Position};
use meissner_skin::{Candidate, Evaluator, Integrator, Method, MethodError, Options, Scene};
use rayon::prelude::*;

const EVERY_DRIVE: &str = "a scene can have every drive of a space";

/// How accurately a contrast is simulated: a search begins with a low fidelity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fidelity {
    /// Duration of the simulation, s.
    pub duration_s: f64,
    /// The step of the propagator; none simulates exactly.
    pub step_us: Option<u32>,
    /// Weights below this count as 0.
    pub min_weight: f64,
}

impl Fidelity {
    /// One second, by the finest method.
    pub const FULL: Self = Self { duration_s: 1.0, step_us: None, min_weight: MIN_WEIGHT };

    fn options(self) -> Options {
        let propagator = |step_us| Method::stepped(step_us, Integrator::Propagator);
        let method = self.step_us.map_or(Method::Exact, propagator);
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
}

impl Score {
    /// The contrast, which a search maximises.
    pub fn cost_hz(self) -> f64 {
        self.on_hz - self.off_hz
    }
}

/// The contrast for a frame as a function of the point.
#[derive(Clone, Debug)]
pub struct Objective {
    /// A scene without drives.
    scene: Scene,
    options: Options,
    duration_s: f64,
    amplitude_um: f64,
    /// The start and end times of a point's drives: one drive without end, or repeats of the frame's duration.
    times: Vec<(Option<f64>, Option<f64>)>,
    /// The populations one after the other, in the order of the scene's afferents.
    partitions: Vec<Partition>,
}

impl Objective {
    /// The contrast for a frame over the populations of some seeds; those without ON or OFF afferents are left out. `noise_seed` seeds
    /// the threshold noise. A frame with an end is repeated, so the contrast accounts for the strokes that the end cuts off.
    ///
    /// # Panics
    /// If no scene can have the fidelity's duration.
    pub fn new(
        target: &Target,
        frame: &Frame,
        populations: &[u64],
        noise_seed: u64,
        fidelity: Fidelity,
    ) -> Self {
        let (array, duration_s) = (target.array(), fidelity.duration_s);
        let (mut afferents, mut partitions) = (Vec::<Position>::new(), Vec::new());
        for &seed in populations {
            let places = membrane::population(seed);
            let partition = Partition::of(&frame.shape, target.reach_mm(), &places);
            if partition.has_both() {
                afferents.extend(places);
                partitions.push(partition);
            }
        }
        let scene = Scene::new(array, duration_s, noise_seed, Vec::new(), afferents, *target.model());
        let scene = scene.expect("the parts of a checked target make a scene");
        let times = match frame.start_s.zip(frame.stop_s) {
            None => vec![(None, None)],
            Some((start_s, stop_s)) => {
                let begins = |number: u32| (stop_s - start_s) * f64::from(number);
                let numbers = (0..).take_while(|&number| begins(number) < duration_s);
                numbers.map(|number| (Some(begins(number)), Some(begins(number + 1)))).collect()
            }
        };
        let (options, amplitude_um) = (fidelity.options(), target.amplitude_um());
        Self { scene, options, duration_s, amplitude_um, times, partitions }
    }

    /// Simulates a point with all afferents.
    ///
    /// # Errors
    /// If the method cannot simulate the target's afferents.
    pub fn at(&self, point: Point) -> Result<Incumbent<'_>, MethodError> {
        let scene = self.scene.with_drives(self.drives(&point)).expect(EVERY_DRIVE);
        let evaluator = Evaluator::new(scene, self.options)?;
        Ok(Incumbent { objective: self, point, score: self.score(evaluator.counts()), evaluator })
    }

    /// The number of afferents in all populations.
    pub fn afferents(&self) -> usize {
        self.scene.afferents().len()
    }

    /// Duration of the simulation, s.
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    fn drives(&self, point: &Point) -> Vec<Drive> {
        let played = |&(start_s, stop_s)| point.drives(self.amplitude_um, start_s, stop_s);
        self.times.iter().flat_map(played).collect()
    }

    /// The score of counts, one for each afferent.
    fn score(&self, mut counts: &[u64]) -> Score {
        let mut sum = Score::default();
        for partition in &self.partitions {
            let (own, rest) = counts.split_at(partition.on().len());
            counts = rest;
            let mut sums = [0; 2];
            for (&on, count) in partition.on().iter().zip(own) {
                sums[usize::from(on)] += count;
            }
            let [off, on] = sums;
            sum.on_hz += on as f64 / partition.on_count() as f64;
            sum.off_hz += off as f64 / partition.off_count() as f64;
        }
        let seconds = self.partitions.len().max(1) as f64 * self.duration_s;
        Score { on_hz: sum.on_hz / seconds, off_hz: sum.off_hz / seconds }
    }
}

/// A point with its score, from which nearby points are simulated for less work.
#[derive(Clone, Debug)]
pub struct Incumbent<'o> {
    objective: &'o Objective,
    point: Point,
    score: Score,
    /// Keeps the part of the incumbent's answer that does not change.
    evaluator: Evaluator,
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
    differing: Candidate,
}

impl<'o> Incumbent<'o> {
    /// The point.
    pub const fn point(&self) -> &Point {
        &self.point
    }

    /// Its score.
    pub const fn score(&self) -> Score {
        self.score
    }

    pub(crate) const fn objective(&self) -> &'o Objective {
        self.objective
    }

    /// Scores other points in parallel. Only the afferents that a changed motor reaches are simulated.
    pub fn try_all(&self, points: Vec<Point>) -> Vec<Tried> {
        let tried = |point: Point| {
            let differing = self.evaluator.evaluate(&self.objective.drives(&point)).expect(EVERY_DRIVE);
            let (score, afferents) = (self.objective.score(&differing.counts()), differing.simulated());
            Tried { point, score, afferents, differing }
        };
        points.into_par_iter().map(tried).collect()
    }

    /// Makes a tried point the incumbent.
    pub fn move_to(&mut self, tried: Tried) {
        (self.point, self.score) = (tried.point, tried.score);
        self.evaluator.accept(tried.differing);
    }
}
