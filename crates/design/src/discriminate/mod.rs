//! Can a finger tell one pattern from another? Observers of simulated spikes.
//!
//! 1. [`Responses::of`] simulates trials of a pattern on a finger, each with its own noise.
//! 2. `observer` estimates the [`Sensitivity`] d′ of observers of counts, and the share of correct answers that follows.
//! 3. [`discriminate`] compares two patterns by counts, by times in bins, and by the total count alone. It does so for each class
//!    and for all afferents, and takes the mean over fingers.
//! 4. `confusion`: [`confusion`] gives the answers of an observer that names one of several patterns.
//!
//! Trials differ only by the noise of the models. The observer knows the finger, the patterns and the start of each interval, so it
//! is far better than any person; an efficiency says by how much.
//!
//! Invariant: the result depends on the patterns, their order, and the [`Plan`] alone.
//!
//! # Sources
//!
//! - Green & Swets 1966: D. M. Green and J. A. Swets, *Signal Detection Theory and Psychophysics*, Wiley, 1966: d′, two intervals.
//! - Tanner & Birdsall 1958: W. P. Tanner and T. G. Birdsall, "Definitions of d′ and η as psychophysical measures", *Journal of the
//!   Acoustical Society of America* 30, 922-928, 1958: efficiency.
//! - Walther et al. 2016: A. Walther, H. Nili, N. Ejaz, A. Alink, N. Kriegeskorte and J. Diedrichsen, "Reliability of dissimilarity
//!   measures for multi-voxel pattern analysis", *NeuroImage* 137, 188-200, 2016: cross-validated distances.

mod confusion;
mod observer;

pub use confusion::{Confusion, confusion};
pub use observer::{LEAST_TRIALS, Sensitivity, correct_of_two, efficiency};
use observer::{independent, linear};

use meissner_array::pattern::Pattern;
use meissner_array::random;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_skin::afferents::Class;
use meissner_skin::{Finger, FingerError, Ramps, RampsError, SkinModel, Stimulus};
use observer::Trials;
use rayon::prelude::*;
use serde::Serialize;

/// The most trials of a pattern on a finger.
pub const MOST_TRIALS: usize = 1000;
/// The most bins of all trials of a pattern on a finger: 566 afferents of two patterns take 226 MB.
pub(crate) const MOST_BINS: usize = 100_000;
/// The most time that is simulated, s: half an hour on one core.
pub(crate) const MOST_SIMULATED_S: f64 = 100_000.0;
/// Separates the seeds of the noise from others.
const NOISE_WORD: u64 = 12;

/// How to compare patterns.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The model.
    pub model: SkinModel,
    /// Trials of each pattern on each finger: [`LEAST_TRIALS`] to [`MOST_TRIALS`].
    pub trials: usize,
    /// Seeds of the fingers; at least one.
    pub fingers: Vec<u64>,
    /// Duration of an interval, s. A shorter pattern is followed by rest, a longer one is cut.
    pub seconds: f64,
    /// Width of a bin of the times, ms.
    pub resolution_ms: f64,
    /// Seed of the noise.
    pub seed: u64,
    /// The efficiency of the observer: 1 is ideal.
    pub efficiency: f64,
}

impl Plan {
    /// Bins of an afferent's times.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates; bounded where it is checked"
    )]
    pub fn bins(&self) -> usize {
        ((self.seconds * 1000.0 / self.resolution_ms - 1e-9).ceil() as usize).max(1)
    }

    /// Checks the plan for this number of patterns.
    ///
    /// # Errors
    /// What is wrong and what to do, if a number is out of its range or the simulation would take too long.
    pub fn check(&self, patterns: usize) -> Result<(), String> {
        if !(LEAST_TRIALS..=MOST_TRIALS).contains(&self.trials) {
            return Err(format!("{} trials: must be {LEAST_TRIALS} to {MOST_TRIALS}", self.trials));
        }
        if self.fingers.is_empty() {
            return Err("no finger: must be 1 or more".to_owned());
        }
        if !(0.001..=20.0).contains(&self.seconds) {
            return Err(format!("{} s: must be 0.001 to 20", self.seconds));
        }
        if !(self.resolution_ms > 0.0 && self.resolution_ms.is_finite()) {
            return Err(format!("a resolution of {} ms: must be above 0", self.resolution_ms));
        }
        if self.bins() > MOST_BINS / self.trials {
            return Err(format!(
                "{} bins of time in {} trials: must be at most {MOST_BINS} in all; take a longer resolution, a shorter interval or \
                 fewer trials",
                self.bins(),
                self.trials
            ));
        }
        let simulated_s = (patterns * self.trials * self.fingers.len()) as f64 * self.seconds;
        if simulated_s > MOST_SIMULATED_S {
            return Err(format!(
                "{simulated_s} s to simulate: must be at most {MOST_SIMULATED_S}; take fewer patterns, trials or fingers"
            ));
        }
        if !(self.efficiency > 0.0 && self.efficiency <= 1.0) {
            return Err(format!("an efficiency of {}: must be above 0, at most 1", self.efficiency));
        }
        Ok(())
    }
}

/// Trials of one pattern on one finger: what an observer may read.
#[derive(Clone, Debug)]
struct Responses {
    /// Spikes per afferent.
    counts: Trials<u32>,
    /// Spikes per afferent and bin, afferent by afferent; empty if they are not wanted.
    times: Trials<u16>,
}

impl Responses {
    /// Simulates a pattern on the finger of a seed. `number` is its place among the patterns. It is a key of the noise, as is the
    /// finger's seed: no two patterns and no two fingers share noise.
    fn of(
        pattern: &Pattern,
        number: usize,
        (finger, seed): (&Finger, u64),
        plan: &Plan,
        with_times: bool,
    ) -> Result<Self, FingerError> {
        let (array, drives) = (pattern.array(), pattern.drives_with_ends());
        // Motions are no drives: they are simulated burst by burst, with the drives beside them.
        let ramps = if pattern.motions().is_empty() { None } else { Some(ramps(pattern, plan.seconds)?) };
        let stimulus = |noise| match &ramps {
            Some(ramps) => Stimulus::of_ramps(ramps, plan.seconds, noise),
            None => Stimulus::of_drives(array, &drives, plan.seconds, noise),
        };
        let bins = plan.bins();
        let trial = |trial: usize| {
            let number = (number as u64) << 32 | trial as u64;
            let [noise, ..] = random::words([plan.seed, number, seed, NOISE_WORD]);
            // Files hold seeds of 63 bits.
            let spikes_s = finger.spikes_s(&stimulus(noise >> 1))?;
            let counts = spikes_s.iter().map(|train| train.len() as u32).collect();
            let mut times = vec![0_u16; if with_times { spikes_s.len() * bins } else { 0 }];
            for (train, bins_of) in spikes_s.iter().zip(times.chunks_mut(bins)) {
                for at_s in train {
                    let bin = ((at_s * 1000.0 / plan.resolution_ms) as usize).min(bins - 1);
                    bins_of[bin] = bins_of[bin].saturating_add(1);
                }
            }
            Ok((counts, times))
        };
        let trials: Result<Vec<_>, FingerError> = (0..plan.trials).into_par_iter().map(trial).collect();
        let (counts, times) = trials?.into_iter().unzip();
        Ok(Self { counts, times })
    }

    /// The sum of the counts of some afferents, as one count.
    fn totals(&self, which: &[u32]) -> Trials<u32> {
        let total = |trial: &Vec<u32>| vec![which.iter().map(|&of| trial[of as usize]).sum()];
        self.counts.iter().map(total).collect()
    }
}

/// How well an observer of some afferents tells two patterns apart: means over fingers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reading {
    /// The observer's sensitivity, at an efficiency of 1.
    pub d_prime: f64,
    /// The standard error of that mean, from the trials.
    pub d_prime_se: f64,
    /// The standard deviation of d′ over fingers; 0 with one finger.
    pub d_prime_sd_fingers: f64,
    /// Correct answers in a two-interval task, per cent, at the plan's efficiency.
    pub correct_percent: f64,
    /// The same at d′ minus and plus one standard error.
    pub correct_percent_range: [f64; 2],
}

/// How well observers of a class of afferents, or of all, tell two patterns apart.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClassReadings {
    /// The class; none: all afferents.
    pub class: Option<Class>,
    /// Afferents of a finger.
    pub afferents: usize,
    /// By each afferent's number of spikes: the ideal observer, because the noise of afferents is independent.
    pub counts: Reading,
    /// By each afferent's spikes in bins of time: a linear observer that learned its weights from the trials, a lower bound. With
    /// few trials it may be worse than the counts.
    pub times: Reading,
    /// By the number of all spikes together: the baseline.
    pub total: Reading,
}

/// Compares two patterns: per class, then by all afferents. `progress` gets the completed share.
///
/// # Errors
/// If a pattern cannot be simulated.
///
/// # Panics
/// If the plan was not checked.
pub fn discriminate(
    patterns: [&Pattern; 2],
    plan: &Plan,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Vec<ClassReadings>, FingerError> {
    let mut found: Vec<(Option<Class>, usize, [Vec<Sensitivity>; 3])> = Vec::new();
    for (number, &seed) in plan.fingers.iter().enumerate() {
        let finger = Finger::new(plan.model, seed);
        let [one, other] = [0, 1].map(|at| Responses::of(patterns[at], at, (&finger, seed), plan, true));
        let (one, other) = (one?, other?);
        for (index, (class, which)) in groups(&finger).into_iter().enumerate() {
            let bins = plan.bins() as u32;
            let in_bins: Vec<u32> = which.iter().flat_map(|of| of * bins..(of + 1) * bins).collect();
            let readings = [
                independent(&one.counts, &other.counts, &which),
                linear(&one.times, &other.times, &in_bins),
                independent(&one.totals(&which), &other.totals(&which), &[0]),
            ];
            if number == 0 {
                found.push((class, which.len(), Default::default()));
            }
            found[index].2.iter_mut().zip(readings).for_each(|(all, reading)| all.push(reading));
        }
        progress((number + 1) as f64 / plan.fingers.len() as f64);
    }
    let of_class = |(class, afferents, readings): (Option<Class>, usize, [Vec<Sensitivity>; 3])| {
        let [counts, times, total] = readings.map(|of| Reading::of(&of, plan.efficiency));
        ClassReadings { class, afferents, counts, times, total }
    };
    Ok(found.into_iter().map(of_class).collect())
}

/// The bursts of an interval: the pattern once, and rest after it.
fn ramps(pattern: &Pattern, seconds: f64) -> Result<Ramps, RampsError> {
    let endless =
        pattern.duration_s().is_none() && pattern.drives().iter().any(|drive| drive.stop_s.is_none());
    let options = StrokeOptions::lasting(endless.then_some(seconds));
    Ramps::of_strokes(Strokes::new(pattern, &options)?, seconds)
}

/// The afferents of each class, and all if there are several.
fn groups(finger: &Finger) -> Vec<(Option<Class>, Vec<u32>)> {
    let classes = finger.model().classes();
    let of_class = |&class: &Class| (Some(class), finger.of_class(class).map(|of| of as u32).collect());
    let all = || (None, (0..finger.afferents().len() as u32).collect());
    classes.iter().map(of_class).chain((classes.len() > 1).then(all)).collect()
}

impl Reading {
    fn of(fingers: &[Sensitivity], efficiency: f64) -> Self {
        let n = fingers.len() as f64;
        let mean = |of: &dyn Fn(&Sensitivity) -> f64| fingers.iter().map(of).sum::<f64>() / n;
        let d_prime = mean(&|of| of.d_prime);
        let d_prime_se = (mean(&|of| of.se * of.se) / n).sqrt();
        let correct = |by: f64| mean(&|of| 100.0 * correct_of_two(of.d_prime + by * d_prime_se, efficiency));
        Self {
            d_prime,
            d_prime_se,
            d_prime_sd_fingers: sd(fingers.iter().map(|of| of.d_prime)).unwrap_or(0.0),
            correct_percent: correct(0.0),
            correct_percent_range: [correct(-1.0), correct(1.0)],
        }
    }
}

/// The standard deviation of a sample; none of fewer than two numbers.
fn sd(numbers: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let n = numbers.clone().count() as f64;
    let mean = numbers.clone().sum::<f64>() / n;
    let squares: f64 = numbers.map(|number| (number - mean) * (number - mean)).sum();
    (n > 1.0).then(|| (squares / (n - 1.0)).sqrt())
}

#[cfg(test)]
mod tests;
