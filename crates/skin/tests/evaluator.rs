//! Every candidate has the answer of a fresh simulation.

use meissner_array::pattern::Drive;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_skin::membrane::{AfferentModel, MIN_WEIGHT};
use meissner_skin::{Evaluator, Integrator, Method, Options, SEARCH_MIN_WEIGHT, Scene, simulate};
use meissner_test_support::paper::MOTORS;
use meissner_test_support::random::Random;
use rayon::prelude::*;

fn methods() -> [Method; 3] {
    let [euler, propagator] = Integrator::ALL.map(|integrator| Method::stepped(500, integrator));
    [Method::Exact, propagator, euler]
}

fn afresh(scene: &Scene, options: &Options) -> Vec<u64> {
    simulate(scene, options, &|_| ()).unwrap().counts
}

/// A change that an optimiser makes to a motor: another frequency, another phase, off, on again, two drives one after the other.
fn changed(random: &mut Random, motor: u8, now: Option<Drive>) -> Vec<Drive> {
    let new = random.drive(motor);
    match (random.below(6), now) {
        (0, Some(now)) => vec![Drive { frequency_hz: new.frequency_hz, ..now }],
        (1, Some(now)) => vec![Drive { phase: new.phase, ..now }],
        (2, _) => vec![],
        (3, Some(now)) => vec![now],
        (4, _) => {
            vec![Drive { stop_s: Some(0.1), ..new }, Drive { start_s: Some(0.15), ..random.drive(motor) }]
        }
        _ => vec![new],
    }
}

/// A random scene of 0.4 s, every other one with noise. A share of `populations` has a whole population.
fn short(random: &mut Random, seed: u64, populations: f64) -> Scene {
    let scene = random.scene(populations);
    let model = AfferentModel { noise_sd: [0.0, 0.05][seed as usize % 2], ..*scene.model() };
    Scene::new(Array::paper(), 0.4, seed, scene.drives().to_vec(), scene.afferents().to_vec(), model).unwrap()
}

/// An evaluator of a random scene: some with noise, with gains, or with a larger least weight.
fn evaluated(seed: u64) -> (Random, Evaluator, Options) {
    let mut random = Random::new(seed);
    let mut scene = short(&mut random, seed, 0.7);
    if random.chance(0.3) {
        scene = scene.with_gains(&PerMotor::from_fn(Array::paper(), |_| random.between(0.8, 1.2))).unwrap();
    }
    let method = methods()[seed as usize % 3];
    let min_weight = if random.chance(0.5) { SEARCH_MIN_WEIGHT } else { MIN_WEIGHT };
    let options = Options { min_weight, ..Options::rates(method) };
    (random, Evaluator::new(scene, options).unwrap(), options)
}

/// Drives with some motors changed: another drive, none, one that does not move.
fn tried(random: &mut Random, drives: &[Drive]) -> Vec<Drive> {
    let mut drives = drives.to_vec();
    for _ in 0..random.below(4) {
        let motor = random.below(MOTORS) as u8;
        let now = drives.iter().copied().find(|drive| drive.motor == motor);
        drives.retain(|drive| drive.motor != motor);
        match random.below(4) {
            0 => drives.push(Drive { amplitude_um: 0.0, ..random.drive(motor) }),
            _ => drives.extend(changed(random, motor, now)),
        }
    }
    drives
}

#[test]
fn a_candidate_has_the_answer_of_a_fresh_simulation_and_changes_nothing() {
    for seed in 0..24 {
        let (mut random, mut evaluator, options) = evaluated(seed);
        let mut spared = false;
        for _ in 0..6 {
            let (scene, counts) = (evaluator.scene().clone(), evaluator.counts().to_vec());
            let candidates: Vec<_> = (0..4).map(|_| tried(&mut random, scene.drives())).collect();
            // Evaluate on several threads at once.
            let mut evaluated: Vec<_> =
                candidates.par_iter().map(|drives| evaluator.evaluate(drives).unwrap()).collect();
            assert_eq!((evaluator.scene(), evaluator.counts()), (&scene, &counts[..]));
            for (candidate, drives) in evaluated.iter().zip(&candidates) {
                let expected = afresh(&scene.with_drives(drives.clone()).unwrap(), &options);
                assert_eq!(candidate.counts(), expected, "seed {seed}");
                spared |= (1..counts.len()).contains(&candidate.simulated());
            }
            let number = random.below(4);
            let accepted = evaluated.swap_remove(number);
            let counts = accepted.counts();
            evaluator.accept(accepted);
            assert_eq!(
                (evaluator.scene().drives(), evaluator.counts()),
                (&candidates[number][..], &counts[..])
            );
        }
        assert!(spared || evaluator.counts().len() < 30, "seed {seed}");
    }
}

#[test]
fn drives_in_another_order_or_the_same_are_not_simulated() {
    let (_, evaluator, _) = evaluated(1);
    let mut drives = evaluator.scene().drives().to_vec();
    drives.reverse();
    assert_eq!(evaluator.evaluate(&drives).unwrap().simulated(), 0);
    drives[0].frequency_hz = 1e6;
    assert!(evaluator.evaluate(&drives).unwrap_err().to_string().contains("drives[0]"));
}

#[test]
fn a_method_that_cannot_simulate_the_scene_is_refused() {
    let scene = Random::new(3).scene(0.0);
    let method = Method::stepped(0, Integrator::Propagator);
    Evaluator::new(scene, Options::rates(method)).unwrap_err();
}
