//! Compares the approximate evaluator of the second model with the full model.
//!
//! Bounds are about twice the measured values.

use meissner_array::pattern::Drive;
use meissner_array::random::uniform;
use meissner_array::spec::Array;
use meissner_skin::afferents::{Class, NearEvaluator, PREINDENT_MM, Scene, population, simulate};
use meissner_skin::membrane::{AfferentModel, Rectify};
use meissner_skin::{Keep, Scene as MembraneScene};
use meissner_test_support::patterns::drive;

const AMPLITUDE_UM: f64 = 80.0;
/// The value of a search's last rounds.
const MIN_SHARE: f64 = 0.01;

fn scene(duration_s: f64, preindent_mm: f64, noise: bool) -> Scene {
    let unused = AfferentModel::default_for(Rectify::Half, 0.0);
    let motors = MembraneScene::new(Array::paper(), duration_s, 5, Vec::new(), Vec::new(), unused).unwrap();
    let rapid = population(3).into_iter().filter(|afferent| afferent.class == Class::Ra).collect();
    Scene::of_motors(&motors, preindent_mm, rapid, noise).unwrap()
}

fn near(scene: &Scene, drives: &[Drive]) -> Vec<u64> {
    NearEvaluator::new(scene, AMPLITUDE_UM, MIN_SHARE).unwrap().evaluate(drives).unwrap().counts()
}

fn exact(scene: &Scene, drives: &[Drive]) -> Vec<u64> {
    simulate(&scene.with_drives(drives.to_vec()).unwrap(), Keep::Rates, &|_| ()).unwrap().counts
}

/// Typical points of a search: few motors in unison, two unisons, all motors at different frequencies, and a repeated frame.
fn points() -> [Vec<Drive>; 5] {
    let hz = |motor: u8| 5.0 * 30_f64.powf(uniform([motor.into(), 0, 0, 1 << 40])[0]);
    let again = |motor: u8| {
        (0..10).map(move |number| {
            let start_s = 0.1 * f64::from(number);
            Drive { start_s: Some(start_s), stop_s: Some(start_s + 0.1), ..drive(motor, 60.0, AMPLITUDE_UM) }
        })
    };
    [
        [5, 7].map(|motor| drive(motor, 60.0, AMPLITUDE_UM)).to_vec(),
        [6, 9, 10, 13, 14].map(|motor| drive(motor, 40.0, AMPLITUDE_UM)).to_vec(),
        (0..24).map(|motor| drive(motor, if motor < 12 { 30.0 } else { 62.5 }, AMPLITUDE_UM)).collect(),
        (0..24).map(|motor| drive(motor, hz(motor), AMPLITUDE_UM)).collect(),
        [1, 2, 5, 6].into_iter().flat_map(again).collect(),
    ]
}

#[test]
fn counts_are_nearly_those_of_the_model() {
    let scene = scene(1.0, PREINDENT_MM, true);
    for (point, drives) in points().iter().enumerate() {
        let (near, exact) = (near(&scene, drives), exact(&scene, drives));
        let total = |counts: &[u64]| counts.iter().sum::<u64>() as f64;
        let squares = near.iter().zip(&exact).map(|(near, exact)| (*near as f64 - *exact as f64).powi(2));
        let rms = (squares.sum::<f64>() / exact.len() as f64).sqrt();
        println!("point {point}: {} spikes, near {}, {rms:.2} impulses/s RMS", total(&exact), total(&near));
        assert!(total(&exact) > 100.0);
        // If all 24 motors move, the neglected influences add up.
        let few = drives.iter().all(|drive| ![0, 23].contains(&drive.motor));
        assert!((total(&near) / total(&exact) - 1.0).abs() < if few { 0.05 } else { 0.15 }, "point {point}");
        assert!(rms < if few { 1.0 } else { 3.0 }, "point {point}: {rms}");
    }
}

#[test]
fn without_noise_counts_are_nearly_those_of_the_model() {
    let scene = scene(1.0, PREINDENT_MM, false);
    for (point, drives) in points().iter().enumerate() {
        let (near, exact) = (near(&scene, drives), exact(&scene, drives));
        let differing = near.iter().zip(&exact).filter(|(near, exact)| near.abs_diff(**exact) > 2).count();
        println!("point {point}: {differing} differ");
        assert!(differing < 80, "point {point}: {differing}");
    }
}

#[test]
fn an_answer_does_not_depend_on_the_drives_before() {
    let scene = scene(0.25, PREINDENT_MM, true);
    let mut evaluator = NearEvaluator::new(&scene, AMPLITUDE_UM, MIN_SHARE).unwrap();
    assert!(evaluator.counts().iter().all(|&count| count == 0));
    for drives in points() {
        let candidate = evaluator.evaluate(&drives).unwrap();
        assert_eq!(candidate.counts(), near(&scene, &drives));
        evaluator.accept(candidate);
        assert_eq!(evaluator.counts(), near(&scene, &drives));
        // With one motor less, only the afferents that it reaches are simulated.
        let fewer = &drives[1..];
        let candidate = evaluator.evaluate(fewer).unwrap();
        assert!(candidate.simulated() < 306, "{}", candidate.simulated());
        assert_eq!(candidate.counts(), near(&scene, fewer));
    }
}

#[test]
fn a_candidate_of_earlier_drives_is_simulated_again() {
    let scene = scene(0.25, PREINDENT_MM, true);
    let mut evaluator = NearEvaluator::new(&scene, AMPLITUDE_UM, MIN_SHARE).unwrap();
    let [first, second, ..] = points();
    let stale = evaluator.evaluate(&second).unwrap();
    evaluator.accept(evaluator.evaluate(&first).unwrap());
    evaluator.accept(stale);
    assert_eq!(evaluator.counts(), near(&scene, &second));
}

/// 80 um do not lift a pin off skin that is pressed in by 0.5 mm, but they do if it is pressed in by only 20 um.
#[test]
fn drives_that_may_lift_a_pin_are_refused() {
    let new = |preindent_mm, amplitude_um| {
        NearEvaluator::new(&scene(0.25, preindent_mm, true), amplitude_um, MIN_SHARE).is_some()
    };
    assert!(new(PREINDENT_MM, AMPLITUDE_UM) && !new(0.02, AMPLITUDE_UM) && !new(PREINDENT_MM, 3000.0));
    // Accepted drives keep contact.
    let scene = scene(0.25, PREINDENT_MM, true);
    for drives in points() {
        let answer = simulate(&scene.with_drives(drives).unwrap(), Keep::Rates, &|_| ()).unwrap();
        assert!(answer.lost_contact_s.iter().all(|&lost_s| lost_s == 0.0));
    }
}
