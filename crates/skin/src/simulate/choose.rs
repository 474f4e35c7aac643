//! The cheapest method whose error is allowed, found on the scene itself.
//!
//! A sample of the receptors that may fire is simulated exactly and by the propagator with ever smaller steps, until
//! the error on the sample leaves room for the sample's own uncertainty. What a method costs on the whole scene is
//! counted in breaks, steps and spikes; when the exact method costs less than the step that would do, it is taken.
//!
//! Invariant: the choice depends on the scene and the error alone, never on a clock.

use super::engine;
use super::track::{Track, of_scene};
use super::{Integrator, Method, MethodError, Options, Precision, Scene, Stepping};
use meissner_array::motor::WINDOW_HALF_TICKS;
use meissner_array::units::HALF_TICKS_PER_S;
use std::sync::Arc;

/// A method chosen for a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// The method.
    pub method: Method,
    /// Its error on the scene: RMS over receptors, impulses/s. 0 for the exact method.
    pub estimated_rate_error_hz: f64,
    /// Receptors the estimate is based on.
    pub sampled: usize,
}

/// Steps that are tried, µs.
const STEPS_US: [u32; 9] = [5000, 2000, 1000, 500, 200, 100, 50, 20, 10];
/// Receptors of a sample.
const SAMPLE: usize = 64;
/// By how much the error on a sample, not on all, must stay below what is allowed.
const ROOM: f64 = 1.3;

/// What a method costs, ns: fitted to the totals of `cargo bench --bench simulate` with and without spikes. Only
/// the ratios matter.
const NS_PER_BREAK: f64 = 2.0;
const NS_PER_EXACT_SPIKE: f64 = 150.0;
const NS_PER_STEP: f64 = 1.2;
const NS_PER_STEPPED_SPIKE: f64 = 50.0;
/// Costs below this are not told apart.
const NOTHING_NS: f64 = 1e6;

/// The cheapest method with an error of at most `error_hz`.
///
/// # Errors
/// If `error_hz` is not an error.
pub fn choose(scene: &Scene, error_hz: f64) -> Result<Choice, MethodError> {
    if !(error_hz > 0.0 && error_hz < f64::INFINITY) {
        return Err(MethodError::RateError { error_hz });
    }
    let all: Vec<u32> = (0..scene.receptors().len() as u32).collect();
    let stepped = |step_us| {
        Method::Stepped(Stepping { step_us, integrator: Integrator::Propagator, precision: Precision::F32 })
    };
    let (sample, share) = if all.len() <= SAMPLE {
        (all, 1.0)
    } else {
        // Whoever is silent at the coarsest step is silent at every other and errs at none.
        let mut audible = engine::audible(scene, &all, &Options::rates(stepped(STEPS_US[0])));
        let share = audible.len() as f64 / all.len() as f64;
        audible.sort_by_key(|&number| scattered(number));
        audible.truncate(SAMPLE);
        (audible, share)
    };
    let by_exact = Choice { method: Method::Exact, estimated_rate_error_hz: 0.0, sampled: sample.len() };
    if sample.is_empty() {
        return Ok(by_exact);
    }
    let exact = counts(scene, &sample, Method::Exact);
    let whole = sample.len() == scene.receptors().len();
    // All that may fire, from what the sample does.
    let scale = if whole { 1.0 } else { share * scene.receptors().len() as f64 / sample.len() as f64 };
    let spikes = exact.iter().sum::<u64>() as f64 * scale;
    let exact_ns = breaks(scene, &sample) * scale * NS_PER_BREAK + spikes * NS_PER_EXACT_SPIKE;
    for step_us in STEPS_US {
        let steps = scene.duration_s() * 1e6 / f64::from(step_us) * sample.len() as f64 * scale;
        let stepped_ns = steps * NS_PER_STEP + spikes * NS_PER_STEPPED_SPIKE;
        if stepped_ns > exact_ns.max(NOTHING_NS) {
            break;
        }
        let method = stepped(step_us);
        // A step may be too short for what f32 can count.
        if method.check(scene).is_err() {
            continue;
        }
        let found = counts(scene, &sample, method);
        let squares: f64 = sample
            .iter()
            .map(|&number| (found[number as usize] as f64 - exact[number as usize] as f64).powi(2))
            .sum();
        // The sample may have missed the spike or two by which the others err.
        let missed = if whole { 0.0 } else { 2.0 };
        let mean = (squares + missed) / sample.len() as f64 * share;
        let estimate = if scene.duration_s() > 0.0 { mean.sqrt() / scene.duration_s() } else { 0.0 };
        if estimate * if whole { 1.0 } else { ROOM } <= error_hz {
            return Ok(Choice { method, estimated_rate_error_hz: estimate, sampled: sample.len() });
        }
    }
    Ok(by_exact)
}

/// Counts of some receptors, at their numbers.
fn counts(scene: &Scene, receptors: &[u32], method: Method) -> Vec<u64> {
    let mut counts = vec![0; scene.receptors().len()];
    let options = Options::rates(method);
    let tracks = of_scene(scene, method);
    let ran = engine::run(scene, &tracks, receptors, &options, &|_| (), |(number, count, _)| {
        counts[number as usize] = count;
    });
    ran.expect("no spikes are kept, so there are never too many");
    counts
}

/// About how many breaks some receptors go through.
fn breaks(scene: &Scene, receptors: &[u32]) -> f64 {
    let options = Options::rates(Method::Exact);
    let of_motor = |track: &Arc<Track>| {
        let reached = |number: &&u32| engine::weight(scene, &options, **number, track.motor()) > 0.0;
        let window = WINDOW_HALF_TICKS as f64 / HALF_TICKS_PER_S;
        track.per_s() * (scene.duration_s() + window) * receptors.iter().filter(reached).count() as f64
    };
    of_scene(scene, Method::Exact).iter().flatten().map(of_motor).sum()
}

/// A receptor's place in an order that has nothing to do with its number.
fn scattered(number: u32) -> u64 {
    (u64::from(number) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(32)
}
