//! What went wrong once: ends within a step, groups that are not full, times that are long in single precision.

use super::{beside, drive, model, propagator, scene, spikes, stroke_up, under};
use meissner::simulate::{Method, Options, Precision, Stepping, simulate};
use meissner::skin::{RaModel, Rectify};

/// The bound of who is silent ends with the scene, the last step after it.
#[test]
fn a_scene_that_ends_within_a_step_is_the_same_with_and_without_skipping() {
    let model = RaModel { alpha_per_um: 0.3, ..model(Rectify::Half) };
    for method in propagator(1_000) {
        spikes(&scene(0.001_51, &[drive(9, 0.001, 80.0)], &[under(9)], model), method);
    }
}

/// Lanes without a receptor stay at time 0, so that relative to now no two states are equal.
#[test]
fn a_group_that_is_not_full_repeats_itself_too() {
    let scene = scene(100.0, &[drive(9, 10.0, 80.0)], &[under(9), beside(9, 0.5)], model(Rectify::Half));
    let skipped = simulate(&scene, &Options::rates(Method::Exact), &|_| ()).unwrap().skipped;
    assert!(skipped.repeated_receptor_s > 150.0, "{skipped:?}");
}

/// The time since a spike is a sum of steps, each rounded to the sum's last bit.
#[test]
fn single_precision_keeps_a_long_refractory_time() {
    let touchy = RaModel { alpha_per_um: 1e3, refractory_s: 0.5, tau_s: 1e3, ..model(Rectify::Half) };
    for integrator in [super::Integrator::Euler, super::Integrator::Propagator] {
        for precision in [Precision::F64, Precision::F32] {
            let method = Method::Stepped(Stepping { step_us: 1, integrator, precision });
            let found = spikes(&stroke_up(touchy, 0.9), method).remove(0);
            assert_eq!(found.len(), 2, "{method:?}: {found:?}");
            let interval_s = found[1] - found[0];
            assert!((interval_s - 0.5).abs() < 2e-6, "{method:?}: {interval_s} s instead of 0.5 s");
        }
    }
}
