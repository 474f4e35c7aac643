//! Finds the cheapest method for an allowed error, by trials on the scene itself.
//!
//! [`choose`] simulates a sample of the afferents that may fire, by the finest method and by the propagator with smaller and smaller steps,
//! until the error on the sample leaves room for the sample's own uncertainty. It estimates a method's cost on the whole scene from
//! its breakpoints, steps and spikes. If the finest method costs less than the step found, it takes that one.
//!
//! Invariant: the choice depends on the scene and the error alone, never on a clock.

use crate::engine;
use crate::member;
use crate::method::{Integrator, Method, MethodError, Options, Precision, Stepping};
use crate::scene::Scene;
use crate::track::{Track, of_scene};
use std::sync::Arc;

/// A method chosen for a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// The method.
    pub method: Method,
    /// Its error on the scene: RMS over afferents, impulses/s. 0 for the finest method.
    pub estimated_rate_error_hz: f64,
    /// The number of afferents in the sample.
    pub sampled: usize,
}

/// The steps to choose from, µs.
const STEPS_US: [u32; 9] = [5000, 2000, 1000, 500, 200, 100, 50, 20, 10];
/// Afferents in a sample.
const SAMPLE: usize = 64;
/// The error on a sample must stay below the allowed error by this factor.
const MARGIN: f64 = 1.3;

/// The cost of a method, ns, fitted to the totals of `cargo bench --bench simulate` with and without spikes. Only the
/// ratios matter.
const NS_PER_BREAKPOINT: f64 = 2.0;
const NS_PER_EXACT_SPIKE: f64 = 150.0;
const NS_PER_STEP: f64 = 1.2;
const NS_PER_STEPPED_SPIKE: f64 = 50.0;
/// Costs below this count as equal.
const NOTHING_NS: f64 = 1e6;

/// Finds the cheapest method whose error is at most `error_hz`, RMS over afferents, impulses/s.
///
/// # Errors
/// If `error_hz` is not a positive number.
pub fn choose(scene: &Scene, error_hz: f64) -> Result<Choice, MethodError> {
    if !(error_hz > 0.0 && error_hz < f64::INFINITY) {
        return Err(MethodError::RateError { error_hz });
    }
    let all: Vec<u32> = (0..scene.afferents().len() as u32).collect();
    let stepped = |step_us| {
        Method::Stepped(Stepping { step_us, integrator: Integrator::Propagator, precision: Precision::F32 })
    };
    let (sample, share) = if all.len() <= SAMPLE {
        (all, 1.0)
    } else {
        // An afferent that is proven silent at the coarsest step is silent at every other step, so it has no error.
        let mut firing = engine::may_fire(scene, &all, &Options::rates(stepped(STEPS_US[0])));
        let share = firing.len() as f64 / all.len() as f64;
        firing.sort_by_key(|&number| scattered(number));
        firing.truncate(SAMPLE);
        (firing, share)
    };
    let finest = Method::Exact;
    let by_finest = Choice { method: finest, estimated_rate_error_hz: 0.0, sampled: sample.len() };
    if sample.is_empty() {
        return Ok(by_finest);
    }
    let expected = counts(scene, &sample, finest);
    let whole = sample.len() == scene.afferents().len();
    // Scale the error from the sample to all afferents that may fire.
    let scale = if whole { 1.0 } else { share * scene.afferents().len() as f64 / sample.len() as f64 };
    let spikes = expected.iter().sum::<u64>() as f64 * scale;
    let steps_ns = |step_us: u32| {
        let steps = scene.duration_s() * 1e6 / f64::from(step_us) * sample.len() as f64 * scale;
        steps * NS_PER_STEP + spikes * NS_PER_STEPPED_SPIKE
    };
    let finest_ns = breakpoints(scene, &sample) * scale * NS_PER_BREAKPOINT + spikes * NS_PER_EXACT_SPIKE;
    for step_us in STEPS_US {
        if steps_ns(step_us) > finest_ns.max(NOTHING_NS) {
            break;
        }
        let method = stepped(step_us);
        // `f32` may be unable to count so many steps.
        if method.check(scene).is_err() {
            continue;
        }
        let found = counts(scene, &sample, method);
        let squares: f64 = sample
            .iter()
            .map(|&number| (found[number as usize] as f64 - expected[number as usize] as f64).powi(2))
            .sum();
        // The other afferents may have one or two wrong spikes that the sample does not show.
        let missed = if whole { 0.0 } else { 2.0 };
        let mean = (squares + missed) / sample.len() as f64 * share;
        let estimate = if scene.duration_s() > 0.0 { mean.sqrt() / scene.duration_s() } else { 0.0 };
        if estimate * if whole { 1.0 } else { MARGIN } <= error_hz {
            return Ok(Choice { method, estimated_rate_error_hz: estimate, sampled: sample.len() });
        }
    }
    Ok(by_finest)
}

/// Spike counts of some afferents, at their numbers.
fn counts(scene: &Scene, numbers: &[u32], method: Method) -> Vec<u64> {
    let mut counts = vec![0; scene.afferents().len()];
    let options = Options::rates(method);
    let tracks = of_scene(scene, method);
    let ran = engine::run(scene, &tracks, numbers, &options, &|_| (), &mut |(number, count, _)| {
        counts[number as usize] = count;
    });
    ran.expect("no spikes are kept, so there are never too many");
    counts
}

/// The approximate number of breakpoints that some afferents pass.
fn breakpoints(scene: &Scene, numbers: &[u32]) -> f64 {
    let options = Options::rates(Method::Exact);
    // Each ramp has breakpoints when it has left the window, too.
    let array = scene.array();
    let window = array.motor().window_half_ticks as f64 / array.rate().half_ticks_per_s();
    let of_motor = |track: &Arc<Track>| {
        let reached = |number: &&u32| member::weight(scene, &options, **number, track.motor()) > 0.0;
        track.breakpoints_per_s()
            * (scene.duration_s() + window)
            * numbers.iter().filter(reached).count() as f64
    };
    of_scene(scene, Method::Exact).iter().flatten().map(of_motor).sum()
}

/// A key that puts afferents into an order unrelated to their numbers.
fn scattered(number: u32) -> u64 {
    (u64::from(number) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(32)
}
