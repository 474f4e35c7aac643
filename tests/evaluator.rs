//! A scene changed motor by motor has the answer of one simulated afresh.

use crate::random::Random;
use meissner::pattern::Drive;
use meissner::simulate::{Evaluator, Integrator, Method, Options, Precision, Scene, Stepping, simulate};
use meissner::skin::{Position, RaModel, Rectify};

fn methods() -> [Method; 3] {
    let stepped = |integrator, precision| Method::Stepped(Stepping { step_us: 500, integrator, precision });
    [
        Method::Exact,
        stepped(Integrator::Propagator, Precision::F32),
        stepped(Integrator::Euler, Precision::F64),
    ]
}

fn afresh(scene: &Scene, options: &Options) -> Vec<u64> {
    simulate(scene, options, &|_| ()).unwrap().counts
}

/// What an optimiser does to a motor: another frequency, another phase, off, on again, one drive after the other.
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

#[test]
fn any_sequence_of_changes_ends_where_a_fresh_simulation_does() {
    for seed in 0..12 {
        let mut random = Random::new(seed);
        let scene = random.scene(0.5);
        let model = RaModel { noise_sd: [0.0, 0.05][seed as usize % 2], ..*scene.model() };
        let (drives, receptors) = (scene.drives().to_vec(), scene.receptors().to_vec());
        let mut scene = Scene::new(0.4, seed, drives, receptors, model).unwrap();
        let options = Options::rates(methods()[seed as usize % 3]);
        let mut evaluator = Evaluator::new(scene.clone(), options).unwrap();
        let mut reused = 0;
        for _ in 0..15 {
            let motor = random.below(24) as u8;
            let now = scene.drives().iter().copied().find(|drive| drive.motor == motor);
            let drives = changed(&mut random, motor, now);
            scene = scene.with_motor(motor, &drives).unwrap();
            reused += evaluator.set_motor(motor, &drives).unwrap().receptors_reused;
            assert_eq!(evaluator.scene(), &scene);
            assert_eq!(evaluator.counts(), afresh(&scene, &options), "seed {seed}");
            let rates = evaluator.counts().iter().map(|&count| count as f64 / 0.4);
            assert_eq!(evaluator.rates_hz(), rates.collect::<Vec<_>>());
        }
        assert!(reused > 0, "seed {seed}");
    }
}

#[test]
fn a_motor_set_to_what_it_does_is_not_simulated() {
    let scene = Random::new(3).scene(1.0);
    let drive = scene.drives()[0];
    let last = *scene.drives().last().unwrap();
    let mut evaluator = Evaluator::new(scene, Options::rates(Method::Exact)).unwrap();
    // The last drive stays the last; the first one's place in the list changes, which matters to nobody.
    let skipped = evaluator.set_motor(last.motor, &[last]).unwrap();
    assert_eq!(skipped.receptors_reused, 306);
    assert_eq!(evaluator.set_motor(drive.motor, &[drive]).unwrap().receptors_reused, 306);
}

#[test]
fn a_refused_change_leaves_everything_as_it_was() {
    let drive =
        Drive { motor: 9, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.0, start_s: None, stop_s: None };
    let receptors = vec![Position { x_mm: -1.5, y_mm: 1.5 }, Position { x_mm: 4.0, y_mm: -7.0 }];
    let model = RaModel::default_for(Rectify::Half, 0.05);
    let scene = Scene::new(0.5, 1, vec![drive, Drive { motor: 23, ..drive }], receptors, model).unwrap();
    for method in methods() {
        let mut evaluator = Evaluator::new(scene.clone(), Options::rates(method)).unwrap();
        let before = evaluator.counts().to_vec();
        assert!(before.iter().all(|&count| count > 0));
        for (motor, drives) in [
            (9, vec![Drive { frequency_hz: 0.0, ..drive }]),
            (9, vec![Drive { phase: 1.0, ..drive }]),
            (9, vec![drive, drive]),
            (23, vec![Drive { start_s: Some(0.2), stop_s: Some(0.1), ..drive }]),
            (24, vec![drive]),
        ] {
            evaluator.set_motor(motor, &drives).unwrap_err();
            assert_eq!((evaluator.scene(), evaluator.counts()), (&scene, &before[..]));
        }
        // And it still works.
        evaluator.set_motor(9, &[]).unwrap();
        assert_eq!((evaluator.counts()[0], evaluator.counts()[1]), (0, before[1]));
    }
}

#[test]
fn a_method_that_cannot_is_refused() {
    let scene = Random::new(3).scene(0.0);
    let method = Stepping { step_us: 0, integrator: Integrator::Propagator, precision: Precision::F64 };
    Evaluator::new(scene, Options::rates(Method::Stepped(method))).unwrap_err();
}
