//! How a scene is simulated: the method, and which parts of the answer are kept.
//!
//! [`Method::check`] refuses a method that cannot simulate a scene, before any work is done.

use crate::membrane::MIN_WEIGHT;
use crate::scene::Scene;
use crate::time::end;
use meissner_array::units::TickRate;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// The most spikes that are kept: 2 to 4 GiB.
pub const MAX_SPIKES: u64 = 1 << 28;

/// Steps, µs.
pub const STEP_US: RangeInclusive<u32> = 1..=1_000_000;

/// How spikes are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// From breakpoint to breakpoint, in closed form.
    Exact,
    /// With a fixed time step.
    Stepped(Stepping),
}

/// A fixed time step, and what a step does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stepping {
    /// The step, within [`STEP_US`].
    pub step_us: u32,
    /// What a step does.
    pub integrator: Integrator,
}

/// What a step does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Integrator {
    /// The paper's eq. 2: input and leak are those at the step's start, and a spike comes at its end.
    Euler,
    /// The exact leak, the mean input, and crossings within the step.
    #[default]
    Propagator,
}

impl Integrator {
    /// All integrators, as the trade-off table lists them.
    pub const ALL: [Self; 2] = [Self::Euler, Self::Propagator];

    /// The name on the command line and in documents.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Euler => "euler",
            Self::Propagator => "propagator",
        }
    }
}

/// What is kept of the spikes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Keep {
    /// Every spike.
    Spikes,
    /// Only their number.
    Rates,
}

/// A method, and what is kept of the answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// The method.
    pub method: Method,
    /// What is kept.
    pub keep: Keep,
    /// Whether to skip work that does not change the answer.
    pub skip: bool,
    /// Weights below this count as 0. The model's value is [`MIN_WEIGHT`]. A search may use [`SEARCH_MIN_WEIGHT`], so that a change
    /// reaches fewer afferents.
    pub min_weight: f64,
}

/// Weights below this may be ignored by a search: a pin then reaches 4.1 mm. Rates change by less than between two populations
/// (`cargo bench --bench simulate` prints the change).
pub const SEARCH_MIN_WEIGHT: f64 = 1e-3;

impl Options {
    /// Every spike, by a method.
    pub const fn spikes(method: Method) -> Self {
        Self { method, keep: Keep::Spikes, skip: true, min_weight: MIN_WEIGHT }
    }

    /// Only rates, by a method.
    pub const fn rates(method: Method) -> Self {
        Self { method, keep: Keep::Rates, ..Self::spikes(method) }
    }
}

/// Why a method cannot simulate a scene.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MethodError {
    /// The step is out of range.
    #[error("a step of {step_us} us: must be {} to {} us", STEP_US.start(), STEP_US.end())]
    Step {
        /// The step.
        step_us: u32,
    },
    /// The step is too long for forward Euler.
    #[error(
        "forward Euler is unstable with a step of {step_us} us at tau_s = {tau_s}: beyond tau it overshoots, \
         beyond 2 tau it grows without end; take a smaller step, or the propagator"
    )]
    Unstable {
        /// The step.
        step_us: u32,
        /// The membrane's time constant.
        tau_s: f64,
    },
    /// There are more spikes than can be kept.
    #[error("more than {MAX_SPIKES} spikes: keep only their rates (--rates-only), or shorten the scene")]
    TooManySpikes,
}

impl Stepping {
    /// The step in half ticks, rounded once.
    pub(crate) fn half_ticks(self, rate: TickRate) -> f64 {
        f64::from(self.step_us) * rate.half_ticks_per_s() / 1e6
    }
}

impl Method {
    /// A fixed step, and what it does.
    pub const fn stepped(step_us: u32, integrator: Integrator) -> Self {
        Self::Stepped(Stepping { step_us, integrator })
    }

    /// Checks whether the method can simulate the scene.
    ///
    /// # Errors
    /// If its step is out of range or unstable.
    pub fn check(&self, scene: &Scene) -> Result<(), MethodError> {
        let Self::Stepped(Stepping { step_us, integrator }) = *self else { return Ok(()) };
        if !STEP_US.contains(&step_us) {
            return Err(MethodError::Step { step_us });
        }
        let tau_s = scene.model().tau_s;
        if integrator == Integrator::Euler && f64::from(step_us) * 1e-6 > tau_s {
            return Err(MethodError::Unstable { step_us, tau_s });
        }
        Ok(())
    }

    /// How far a scene is computed, half ticks: the last step is a whole one.
    pub(crate) fn horizon(self, duration_s: f64, rate: TickRate) -> f64 {
        match self {
            Self::Exact => end(duration_s, rate),
            Self::Stepped(stepping) => {
                (end(duration_s, rate) / stepping.half_ticks(rate)).ceil() * stepping.half_ticks(rate)
            }
        }
    }
}
