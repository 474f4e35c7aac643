//! Bugs that were fixed: an end within a step, many drives of a motor.

use super::{drive, model, propagator, scene, spikes, under};
use meissner_array::pattern::Drive;
use meissner_skin::membrane::{AfferentModel, Rectify};
use meissner_skin::{Method, Options, simulate};

/// The proof of silence once ended with the scene, but the last step ends after it.
#[test]
fn a_scene_that_ends_within_a_step_is_the_same_with_and_without_skipping() {
    let model = AfferentModel { alpha_per_um: 0.3, ..model(Rectify::Half) };
    spikes(&scene(0.001_51, &[drive(9, 0.001, 80.0)], &[under(9)], model), propagator(1_000));
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
