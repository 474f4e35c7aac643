//! Extreme scenes, by every method: each has one right answer.
//!
//! The answer comes from the oracle where it promises one, else from a closed form beside the test. A stepped method must fulfil
//! its definition: at most one spike per step, the error of its step, and only finite numbers.
//!
//! Invariant: every scene here is simulated with and without skipping, for spikes and for rates, with the same answer.

mod afferents;
mod drives;
mod events;
mod sizes;

use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::membrane::{AfferentModel, Position, Rectify};
use meissner_skin::{Integrator, Method, Options, Scene, Stepping, simulate};
use meissner_test_support::both::for_oracle;
use meissner_test_support::oracle;
use meissner_test_support::patterns::drive;

/// No spikes.
const NONE: [f64; 0] = [];

/// A model without noise.
fn model(rectify: Rectify) -> AfferentModel {
    AfferentModel::default_for(rectify, 0.0)
}

/// The position `right_mm` to the right of a pin.
fn beside(motor: u8, right_mm: f64) -> Position {
    let [x_mm, y_mm] = Array::paper().position_mm(motor);
    Position { x_mm: x_mm + right_mm, y_mm }
}

fn under(motor: u8) -> Position {
    beside(motor, 0.0)
}

fn scene(duration_s: f64, drives: &[Drive], afferents: &[Position], model: AfferentModel) -> Scene {
    Scene::new(Array::paper(), duration_s, 7, drives.to_vec(), afferents.to_vec(), model).unwrap()
}

/// One stroke up at time 0, so that a sensitive afferent spikes as often as it can.
fn stroke_up(sensitive: AfferentModel, duration_s: f64) -> Scene {
    scene(duration_s, &[drive(9, 0.001, 80.0)], &[under(9)], sensitive)
}

const fn euler(step_us: u32) -> Method {
    Method::stepped(step_us, Integrator::Euler)
}

const fn propagator(step_us: u32) -> Method {
    Method::stepped(step_us, Integrator::Propagator)
}

const fn stepped(step_us: u32) -> [Method; 2] {
    [euler(step_us), propagator(step_us)]
}

const fn methods(step_us: u32) -> [Method; 3] {
    [Method::Exact, euler(step_us), propagator(step_us)]
}

/// Spikes, checked for properties that every scene and method has.
fn spikes(scene: &Scene, method: Method) -> Vec<Vec<f64>> {
    let options = Options::spikes(method);
    let answer = simulate(scene, &options, &|_| ()).unwrap();
    let trains = answer.spikes_s.unwrap();
    let counts: Vec<u64> = trains.iter().map(|train| train.len() as u64).collect();
    assert_eq!(answer.counts, counts, "{method:?}");
    let unskipped = simulate(scene, &Options { skip: false, ..options }, &|_| ()).unwrap();
    assert_eq!(unskipped.spikes_s.as_ref(), Some(&trains), "{method:?}: skipping changes spikes");
    for skip in [true, false] {
        let rates = simulate(scene, &Options { skip, ..Options::rates(method) }, &|_| ()).unwrap();
        assert_eq!((rates.spikes_s, rates.counts), (None, counts.clone()), "{method:?}: rates only");
    }
    let least_s = match method {
        Method::Exact => scene.model().refractory_s,
        // Euler's spikes lie at the ends of steps.
        Method::Stepped(Stepping { step_us, integrator: Integrator::Euler, .. }) => {
            scene.model().refractory_s.max(f64::from(step_us) * 1e-6)
        }
        Method::Stepped(_) => scene.model().refractory_s,
    };
    let steps = match method {
        Method::Exact => f64::INFINITY,
        Method::Stepped(Stepping { step_us, .. }) => (scene.duration_s() / f64::from(step_us) * 1e6).ceil(),
    };
    for train in &trains {
        assert!(train.iter().all(|t| (0.0..scene.duration_s()).contains(t)), "{method:?}: {train:?}");
        assert!(train.len() as f64 <= steps, "{method:?}: {} spikes", train.len());
        let last_bits = 2.0 * scene.duration_s() * f64::EPSILON;
        for pair in train.windows(2) {
            assert!(pair[1] - pair[0] >= least_s * (1.0 - 1e-5) - last_bits, "{method:?}: {pair:?}");
        }
    }
    trains
}

fn exact(scene: &Scene) -> Vec<Vec<f64>> {
    spikes(scene, Method::Exact)
}

/// The exact method's spikes. The oracle must promise, and have, at least `least` of them.
fn as_the_oracle(scene: &Scene, least: usize) -> Vec<Vec<f64>> {
    let found = exact(scene);
    let compared = oracle::compare(&oracle::spikes(&for_oracle(scene)), &found, 1e-9).unwrap();
    assert!(compared >= least, "{compared} compared of {found:?}");
    found
}

/// Checks that each afferent has the same number of spikes, up to `off`, by the stepped methods as by the exact one.
fn counts_near(scene: &Scene, step_us: u32, off: usize) {
    let expected = exact(scene);
    for method in stepped(step_us) {
        for (expected, found) in expected.iter().zip(spikes(scene, method)) {
            let (expected, found) = (expected.len(), found.len());
            assert!(expected.abs_diff(found) <= off, "{method:?}: {found} instead of {expected}");
        }
    }
}

fn assert_close(found: &[f64], expected: &[f64], tolerance_s: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}: {found:?} instead of {expected:?}");
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= tolerance_s, "{what}: {found} instead of {expected}");
    }
}
