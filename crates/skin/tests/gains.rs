//! A motor's gain scales its effect on the skin, by every method.

use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_skin::membrane::AfferentModel;
use meissner_skin::{Answer, Evaluator, Integrator, Method, Options, Scene, simulate as solve};
use meissner_test_support::random::Random;
use meissner_test_support::{both, oracle};

const METHODS: [Method; 3] =
    [Method::Exact, Method::stepped(300, Integrator::Propagator), Method::stepped(300, Integrator::Euler)];

fn answer(scene: &Scene, method: Method) -> Answer {
    solve(scene, &Options::spikes(method), &|_| ()).unwrap()
}

fn spread(random: &mut Random) -> PerMotor<f64> {
    PerMotor::from_fn(Array::paper(), |_| random.between(0.5, 2.0))
}

#[test]
fn gains_are_those_of_the_oracle() {
    let mut compared = 0;
    for seed in 0..100 {
        let noise_sd = [0.0, 0.05][seed as usize % 2];
        let gains = spread(&mut Random::new(seed));
        let (theirs, ours) = both::both(oracle::random_scene(seed), noise_sd, seed);
        let found = answer(&ours.with_gains(&gains).unwrap(), Method::Exact).spikes_s.unwrap();
        compared += oracle::compare(&oracle::spikes_with_gains(&theirs, &gains), &found, 1e-9)
            .unwrap_or_else(|error| panic!("scene {seed}: {error}"));
    }
    assert!(compared > 5_000, "{compared}");
}

/// The model is linear before rectification, so a common gain of all motors acts like the afferents' sensitivity.
#[test]
fn the_same_gain_of_all_motors_is_alpha() {
    for seed in 0..12 {
        let scene = Random::new(seed).scene(0.5);
        // A power of 2, so that nothing is rounded differently.
        let gain = [0.5, 2.0][seed as usize % 2];
        let model = AfferentModel { alpha_per_um: gain * scene.model().alpha_per_um, ..*scene.model() };
        let (drives, afferents) = (scene.drives().to_vec(), scene.afferents().to_vec());
        let louder =
            Scene::new(Array::paper(), scene.duration_s(), scene.seed(), drives, afferents, model).unwrap();
        let gained = scene.with_gains(&PerMotor::all(Array::paper(), gain)).unwrap();
        for method in METHODS {
            let (louder, gained) = (answer(&louder, method), answer(&gained, method));
            assert_eq!(louder.counts, gained.counts, "seed {seed}, {method:?}");
            assert_eq!(louder.spikes_s, gained.spikes_s, "seed {seed}, {method:?}");
        }
    }
}

/// With gains from 0 to 10, neither skipping nor an evaluator changes the answer.
#[test]
fn skipping_takes_gains_into_account() {
    for seed in 0..9 {
        let mut random = Random::new(seed);
        let gains = PerMotor::from_fn(Array::paper(), |_| random.log_between(0.01, 10.0));
        let scene = random.scene(0.5).with_gains(&gains).unwrap();
        let options = Options::rates(METHODS[seed as usize % 3]);
        let all = solve(&scene, &Options { skip: false, ..options }, &|_| ()).unwrap();
        let evaluator = Evaluator::new(scene.clone(), options).unwrap();
        assert_eq!(evaluator.counts(), all.counts, "seed {seed}");
        let mut drives = scene.drives().to_vec();
        drives[0] = random.drive(drives[0].motor);
        let changed = solve(&scene.with_drives(drives.clone()).unwrap(), &options, &|_| ()).unwrap();
        assert_eq!(evaluator.evaluate(&drives).unwrap().counts(), changed.counts, "seed {seed}");
    }
}
