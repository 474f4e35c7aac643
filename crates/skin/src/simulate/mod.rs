//! From what the motors do to the spikes of the skin's receptors.
//!
//! A [`Scene`] says which motors are driven and how, where the receptors lie and what they are made of. Its drives
//! become strokes by the rule that the streamer plays by, the strokes become breaks (`breaks`, kept in `track`) of the motors'
//! velocities, and between breaks a receptor's input is a straight line. From there two ways lead to spikes:
//!
//! - **exact**: from break to break in closed form (`membrane`), eight receptors abreast (`exact`); where a
//!   threshold may be reached, one by one, and the crossing is solved for (`neuron`). No time step anywhere.
//! - **stepped**: a fixed step (`stepped`) over the velocities on a grid (`sampler`), by forward Euler as the paper does it, or by
//!   the exact propagator of the leak.
//!
//! Both draw the same noise, so they can be compared spike by spike. What need not be computed is not: motors at rest, receptors
//! out of reach or provably silent (`silent`), a state that repeats itself (`cycle`), and with an [`Evaluator`] the
//! receptors that a change does not reach. [`choose`] finds the cheapest method for an error that is allowed.
//!
//! What is known to be missing: there is no low-pass before the membrane, so that above about 50 Hz the model is more
//! sensitive than recordings are; the skin has no mechanics; rectification, depth and reset are our reading of the literature.
//!
//! What motors really did, each burst with a travel of its own, is simulated from their [`Ramps`], exactly ([`simulate_ramps`]).
//!
//! Invariant: the answer for a receptor depends on what the scene says of it, on the method, and on its number, which
//! keys its noise: not on threads, the width of vectors, other receptors, or what is skipped.

mod breaks;
mod choose;
mod cycle;
mod engine;
mod evaluator;
mod exact;
mod lanes;
mod membrane;
mod neuron;
mod ramps;
mod sampler;
mod scene;
mod silent;
mod stepped;
#[cfg(test)]
mod tests;
mod track;

pub use choose::{Choice, choose};
pub use evaluator::{Evaluator, Trial};
pub use meissner_input::document::{Mistake, Place};
pub use ramps::{Ramps, RampsError, simulate_ramps};
pub use scene::{MAX_JSON_BYTES, MAX_TOML_BYTES, Problem, Scene, SceneError};
pub use scene::{MOST_ALPHA_PER_UM, RawReceptor, check_model};

use crate::afferent::LEAST_WEIGHT;
use breaks::end;
use engine::Member;
use meissner_array::units::HALF_TICKS_PER_S;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Spikes that are kept at the most: 2 to 4 GiB.
pub const MOST_SPIKES: u64 = 1 << 28;

/// Steps, µs.
pub const STEP_US: RangeInclusive<u32> = 1..=1_000_000;

/// How a scene is simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Event driven, in closed form.
    Exact,
    /// By a fixed step.
    Stepped(Stepping),
}

/// A way to step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stepping {
    /// The step, within [`STEP_US`].
    pub step_us: u32,
    /// What is done in a step.
    pub integrator: Integrator,
    /// Of what numbers.
    pub precision: Precision,
}

/// What is done in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Integrator {
    /// The paper's eq. 2: input and leak as they are at the step's start, a spike at its end.
    Euler,
    /// The leak exactly, the input by its mean, crossings within the step.
    #[default]
    Propagator,
}

/// What numbers a stepped method computes with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision.
    #[default]
    F32,
    /// Double precision.
    F64,
}

impl Integrator {
    /// As on the command line, and in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Euler => "euler",
            Self::Propagator => "propagator",
        }
    }
}

impl Precision {
    /// As on the command line, and in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }
}

/// What is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// Every spike.
    Spikes,
    /// How many.
    Rates,
}

/// How to simulate, and what for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// The method.
    pub method: Method,
    /// What is kept.
    pub keep: Keep,
    /// Whether what need not be computed is left out; the answer is the same.
    pub skip: bool,
    /// Weights below this count as 0. [`LEAST_WEIGHT`] is the model's; a search may take more, as
    /// [`SEARCH_LEAST_WEIGHT`]: then fewer receptors feel a change.
    pub least_weight: f64,
}

/// Weights that a search may leave out: a pin is felt up to 4.1 mm. That moves rates by less than the
/// noise between two populations does (`cargo bench --bench simulate` prints by how much).
pub const SEARCH_LEAST_WEIGHT: f64 = 1e-3;

impl Options {
    /// Spikes by a method.
    #[must_use]
    pub const fn spikes(method: Method) -> Self {
        Self { method, keep: Keep::Spikes, skip: true, least_weight: LEAST_WEIGHT }
    }

    /// Rates by a method.
    #[must_use]
    pub const fn rates(method: Method) -> Self {
        Self { method, keep: Keep::Rates, ..Self::spikes(method) }
    }
}

/// A method that cannot simulate a scene.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MethodError {
    /// A step out of range.
    #[error("a step of {step_us} us: must be {} to {} us", STEP_US.start(), STEP_US.end())]
    Step {
        /// As asked for.
        step_us: u32,
    },
    /// Euler overshoots.
    #[error(
        "forward Euler is unstable with a step of {step_us} us at tau_s = {tau_s}: beyond tau it overshoots, \
         beyond 2 tau it grows without end; take a smaller step, or the propagator"
    )]
    Unstable {
        /// As asked for.
        step_us: u32,
        /// The membrane's time constant.
        tau_s: f64,
    },
    /// Single precision cannot count so many steps.
    #[error(
        "f32 counts {COUNTABLE} steps since a spike, and {key} is {steps:.0} steps of {step_us} us: take a \
         larger step, or f64"
    )]
    Precision {
        /// Which time is too long.
        key: &'static str,
        /// How many steps it is.
        steps: f64,
        /// As asked for.
        step_us: u32,
    },
    /// More spikes than are kept.
    #[error("more than {MOST_SPIKES} spikes: keep only their rates (--rates-only), or shorten the scene")]
    TooManySpikes,
    /// An error that cannot be allowed.
    #[error("a rate error of {error_hz}: must be a number of impulses/s, above 0")]
    RateError {
        /// As asked for.
        error_hz: f64,
    },
}

/// Steps that `f32` counts one by one.
const COUNTABLE: f64 = 8_388_608.0;

impl Method {
    /// Whether the method can simulate the scene.
    ///
    /// # Errors
    /// If its step is out of range, unstable, or too short for what `f32` can count.
    pub fn check(&self, scene: &Scene) -> Result<(), MethodError> {
        let Self::Stepped(Stepping { step_us, integrator, precision }) = *self else { return Ok(()) };
        if !STEP_US.contains(&step_us) {
            return Err(MethodError::Step { step_us });
        }
        let tau_s = scene.model().tau_s;
        if integrator == Integrator::Euler && f64::from(step_us) * 1e-6 > tau_s {
            return Err(MethodError::Unstable { step_us, tau_s });
        }
        let steps = |time_s: f64| time_s * 1e6 / f64::from(step_us);
        if precision == Precision::F32 && steps(scene.duration_s()) > COUNTABLE {
            let model = scene.model();
            for (key, time_s) in
                [("refractory_s", model.refractory_s), ("hyperexcitability_s", model.hyperexcitability_s)]
            {
                if steps(time_s) > COUNTABLE {
                    return Err(MethodError::Precision { key, steps: steps(time_s), step_us });
                }
            }
        }
        Ok(())
    }
}

/// The answer to a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Spikes of each receptor with `0 <= t < duration_s`.
    pub counts: Vec<u64>,
    /// Their times, if they were kept.
    pub spikes_s: Option<Vec<Vec<f64>>>,
    /// What was not computed.
    pub skipped: Skipped,
}

impl Answer {
    /// Each receptor's impulses per second; 0 in a scene without duration.
    #[must_use]
    pub fn rates_hz(&self, scene: &Scene) -> Vec<f64> {
        self.counts.iter().map(|&count| rate_hz(count, scene)).collect()
    }
}

fn in_seconds(mut half_ticks: Vec<f64>) -> Vec<f64> {
    half_ticks.iter_mut().for_each(|at| *at /= HALF_TICKS_PER_S);
    half_ticks
}

/// A step in half ticks, rounded once.
fn step_half_ticks(step_us: u32) -> f64 {
    f64::from(step_us) * HALF_TICKS_PER_S / 1e6
}

/// Up to where a scene is computed, half ticks: the last step is a whole one.
fn horizon(duration_s: f64, method: Method) -> f64 {
    match method {
        Method::Exact => end(duration_s),
        Method::Stepped(Stepping { step_us, .. }) => {
            (end(duration_s) / step_half_ticks(step_us)).ceil() * step_half_ticks(step_us)
        }
    }
}

fn rate_hz(count: u64, scene: &Scene) -> f64 {
    if count == 0 { 0.0 } else { count as f64 / scene.duration_s() }
}

/// What was not computed, each for a reason that makes the answer exact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Skipped {
    /// Without a stroke: their input is 0.
    pub motors_at_rest: u32,
    /// Their weight counts as 0 at every receptor.
    pub motors_out_of_reach: u32,
    /// No moving motor has a weight there: the membrane stays at rest, below the least threshold.
    pub receptors_out_of_reach: u64,
    /// Even without cancellation their input cannot take them to their first threshold.
    pub receptors_below_threshold: u64,
    /// Receptor-seconds after a state that had been there before, bit by bit.
    pub repeated_receptor_s: f64,
    /// Not reached by what changed since the last evaluation.
    pub receptors_reused: u64,
}

/// Simulates a scene. `progress` hears now and then which part is done, on any thread.
///
/// # Errors
/// If the method cannot simulate the scene, or if there are more spikes than are kept.
pub fn simulate(
    scene: &Scene,
    options: &Options,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Answer, MethodError> {
    options.method.check(scene)?;
    let receptors: Vec<u32> = (0..scene.receptors().len() as u32).collect();
    let mut counts = vec![0; receptors.len()];
    let mut spikes = vec![Vec::new(); if options.keep == Keep::Spikes { receptors.len() } else { 0 }];
    let tracks = track::of_scene(scene, options.method);
    let skipped =
        engine::run(scene, &tracks, &receptors, options, progress, |(number, count, half_ticks)| {
            counts[number as usize] = count;
            if let Some(spikes) = spikes.get_mut(number as usize) {
                *spikes = in_seconds(half_ticks);
            }
        })?;
    let spikes_s = (options.keep == Keep::Spikes).then_some(spikes);
    Ok(Answer { counts, spikes_s, skipped })
}
