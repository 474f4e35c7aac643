//! Bugs that were fixed: ends within a step, groups that are not full, long times in single precision.

use super::{beside, drive, model, propagator, scene, spikes, stroke_up, under};
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::membrane::{AfferentModel, Rectify, population};
use meissner_skin::{MAX_SPIKES, Method, Options, Precision, Scene, Stepping, choose, simulate};
use meissner_test_support::statistics::rms;

/// The proof of silence once ended with the scene, but the last step ends after it.
#[test]
fn a_scene_that_ends_within_a_step_is_the_same_with_and_without_skipping() {
    let model = AfferentModel { alpha_per_um: 0.3, ..model(Rectify::Half) };
    for method in propagator(1_000) {
        spikes(&scene(0.001_51, &[drive(9, 0.001, 80.0)], &[under(9)], model), method);
    }
}

/// Lanes without an afferent stay at time 0, so no two of their states are equal relative to now.
#[test]
fn a_group_that_is_not_full_repeats_itself_too() {
    let scene = scene(100.0, &[drive(9, 10.0, 80.0)], &[under(9), beside(9, 0.5)], model(Rectify::Half));
    let skipped = simulate(&scene, &Options::rates(Method::Exact), &|_| ()).unwrap().skipped;
    assert!(skipped.repeated_afferent_s > 150.0, "{skipped:?}");
}

/// The time since a spike is a sum of steps, each rounded to the sum's last bit.
#[test]
fn single_precision_keeps_a_long_refractory_time() {
    let sensitive =
        AfferentModel { alpha_per_um: 1e3, refractory_s: 0.5, tau_s: 1e3, ..model(Rectify::Half) };
    for integrator in [super::Integrator::Euler, super::Integrator::Propagator] {
        for precision in [Precision::F64, Precision::F32] {
            let method = Method::Stepped(Stepping { step_us: 1, integrator, precision });
            let found = spikes(&stroke_up(sensitive, 0.9), method).remove(0);
            assert_eq!(found.len(), 2, "{method:?}: {found:?}");
            let interval_s = found[1] - found[0];
            assert!((interval_s - 0.5).abs() < 2e-6, "{method:?}: {interval_s} s instead of 0.5 s");
        }
    }
}

/// A lane is known only up to its last breakpoint, which may lie before the multiple of the period.
#[test]
fn a_repetition_reaches_to_the_end_of_the_scene() {
    let model = AfferentModel { tau_s: 0.01, ..model(Rectify::Signed) };
    let mut repeated = 0.0;
    for phase in [0.0, 0.3, 0.7, 0.964] {
        for duration_s in [3.05, 3.0999, 3.1, 3.1001, 3.1437] {
            let drive = Drive { phase, ..drive(9, 10.0, 80.0) };
            let scene = scene(duration_s, &[drive], &[under(9)], model);
            let [on, off] = [true, false].map(|skip| {
                simulate(&scene, &Options { skip, ..Options::spikes(Method::Exact) }, &|_| ()).unwrap()
            });
            assert_eq!(on.spikes_s, off.spikes_s, "{phase} {duration_s}");
            assert_eq!(on.counts, off.counts, "{phase} {duration_s}");
            repeated += on.skipped.repeated_afferent_s;
        }
    }
    assert!(repeated > 10.0, "{repeated}");
}

/// A coarse step misses a fast drive entirely, which is no reason to choose it.
#[test]
fn a_method_that_misses_all_spikes_is_not_chosen() {
    let drives: Vec<_> = (0..24)
        .map(|motor| Drive { phase: f64::from(motor) * 0.37 % 1.0, ..drive(motor, 1000.0, 80.0) })
        .collect();
    let model = AfferentModel { alpha_per_um: 0.2, ..AfferentModel::default_for(Rectify::Half, 0.05) };
    let scene = Scene::new(Array::paper(), 0.5, 0, drives, population(1), model).unwrap();
    let choice = choose(&scene, 1.0).unwrap();
    let rates = |method| simulate(&scene, &Options::rates(method), &|_| ()).unwrap().rates_hz(&scene);
    let (exact, chosen) = (rates(Method::Exact), rates(choice.method));
    let error_hz = rms(exact.iter().zip(&chosen).map(|(exact, chosen)| exact - chosen));
    assert!(exact.iter().sum::<f64>() > 0.0 && error_hz <= 1.0, "{choice:?}: {error_hz}");
}

/// A step that `f32` cannot count is not chosen.
#[test]
fn a_method_that_would_be_refused_is_not_chosen() {
    let model = AfferentModel { hyperexcitability_s: 45_000.0, ..model(Rectify::Half) };
    let scene = scene(50_000.0, &[Drive { stop_s: Some(1.0), ..drive(9, 100.0, 80.0) }], &[under(9)], model);
    choose(&scene, 5.0).unwrap().method.check(&scene).unwrap();
}

/// Drives that follow each other do not overlap.
#[test]
fn a_motor_may_have_many_drives() {
    let drives: Vec<_> = (0..50_000)
        .map(|index| {
            let at = |index: i32| Some(f64::from(index) * 0.001);
            Drive { start_s: at(index), stop_s: at(index + 1), ..drive(9, 2000.0, 1.0) }
        })
        .collect();
    let scene = scene(0.05, &drives, &[under(9)], model(Rectify::Half));
    simulate(&scene, &Options::rates(Method::Exact), &|_| ()).unwrap();
}

/// Repetition makes it easy to ask for more spikes than a machine can hold.
#[test]
fn too_many_spikes_to_keep_are_refused_before_they_are_kept() {
    let model = AfferentModel { alpha_per_um: 1e6, refractory_s: 1e-5, ..model(Rectify::Half) };
    let scene = scene(1e5, &[drive(9, 60.0, 80.0)], &[under(9)], model);
    let refused = simulate(&scene, &Options::spikes(Method::Exact), &|_| ()).unwrap_err();
    assert!(refused.to_string().contains("--rates-only"), "{refused}");
    let counted = simulate(&scene, &Options::rates(Method::Exact), &|_| ()).unwrap();
    assert!(counted.counts[0] > MAX_SPIKES);
}
