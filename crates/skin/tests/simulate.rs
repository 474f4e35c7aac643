//! The exact and stepped methods against references: another program's spikes, and the oracle's.

use meissner_skin::{Answer, Integrator, Method, Options, Scene, simulate};
use meissner_test_support::both::both;
use meissner_test_support::oracle;
use serde_json::Value;

fn solve(scene: &Scene, method: Method) -> Answer {
    simulate(scene, &Options::spikes(method), &|_| ()).unwrap()
}

fn exact(scene: &Scene) -> Vec<Vec<f64>> {
    solve(scene, Method::Exact).spikes_s.unwrap()
}

#[test]
fn the_exact_method_gives_the_reference_spikes() {
    let scenes: Vec<Value> = serde_json::from_str(include_str!("data/spikes.json")).unwrap();
    let mut compared = 0;
    for (index, value) in scenes.iter().enumerate() {
        let scene = Scene::read(&value.to_string(), "spikes.json").unwrap();
        let found = exact(&scene);
        let expected: Vec<Vec<f64>> = serde_json::from_value(value["spikes_s"].clone()).unwrap();
        let promised: Vec<i64> = serde_json::from_value(value["promised_spikes"].clone()).unwrap();
        for ((found, expected), promised) in found.iter().zip(&expected).zip(promised) {
            let promised = usize::try_from(promised);
            if promised == Ok(expected.len()) {
                assert_eq!(found.len(), expected.len(), "scene {index}");
            }
            for (found, expected) in found.iter().zip(expected).take(promised.unwrap_or(usize::MAX)) {
                assert!((found - expected).abs() < 1e-9, "scene {index}: {found} instead of {expected}");
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 760);
}

#[test]
fn the_exact_method_agrees_with_the_oracle() {
    let mut compared = 0;
    for seed in 0..300 {
        let noise_sd = [0.0, 0.05, 1.0][seed as usize % 3];
        let (theirs, ours) = both(oracle::random_scene(seed), noise_sd, seed);
        compared += oracle::compare(&oracle::spikes(&theirs), &exact(&ours), 1e-9)
            .unwrap_or_else(|error| panic!("scene {seed}: {error}"));
    }
    assert!(compared > 15_000, "{compared}");
}

/// Two random scenes of each shipped array: the exact method has the oracle's spikes, and the propagator nearly as many.
#[test]
fn on_every_shipped_array_the_methods_agree_with_the_oracle() {
    let shipped = oracle::Array::shipped();
    assert_eq!(shipped.iter().map(|array| array.name).collect::<Vec<_>>(), meissner_array::spec::names());
    let propagator = Method::stepped(20, Integrator::Propagator);
    for array in shipped {
        let (mut compared, mut near, mut all) = (0, 0, 0);
        for seed in 1000..1040 {
            let noise_sd = [0.0, 0.05][seed as usize % 2];
            let (theirs, ours) = both(oracle::random_scene_on(array.clone(), seed), noise_sd, seed);
            let found = solve(&ours, Method::Exact);
            compared += oracle::compare(&oracle::spikes(&theirs), found.spikes_s.as_ref().unwrap(), 1e-9)
                .unwrap_or_else(|error| panic!("{}, scene {seed}: {error}", array.name));
            let stepped = solve(&ours, propagator).counts;
            near += stepped.iter().zip(&found.counts).filter(|(a, b)| a.abs_diff(**b) <= 1).count();
            all += stepped.len();
        }
        assert!(compared > 1000, "{}: {compared}", array.name);
        assert!(100 * near > 97 * all, "{}: {near} of {all}", array.name);
    }
}
