//! The exact and stepped methods against references: another program's spikes, and the oracle's.

use crate::oracle;
use meissner::draw::Normals;
use meissner::pattern::Drive;
use meissner::simulate::{Answer, Method, Options, Scene, simulate};
use meissner::skin::{Position, RaModel, Rectify};
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

/// A scene of the oracle's as one of ours, and the noise in it as the oracle wants it.
pub(crate) fn both(mut scene: oracle::Scene, noise_sd: f64, seed: u64) -> (oracle::Scene, Scene) {
    let drives = scene.drives.iter().map(|drive| Drive {
        motor: drive.motor as u8,
        frequency_hz: drive.frequency_hz,
        amplitude_um: drive.amplitude_um,
        phase: drive.phase,
        start_s: Some(drive.start_s),
        stop_s: drive.stop_s,
    });
    let model = RaModel {
        rectify: match scene.model.rectify {
            oracle::Rectify::Half => Rectify::Half,
            oracle::Rectify::Full => Rectify::Full,
            oracle::Rectify::Signed => Rectify::Signed,
        },
        alpha_per_um: scene.model.alpha_per_um,
        tau_s: scene.model.tau_s,
        refractory_s: scene.model.refractory_s,
        hyperexcitability_s: scene.model.hyperexcitability_s,
        hyperexcitability_depth: scene.model.hyperexcitability_depth,
        sigma_mm: scene.model.sigma_mm,
        noise_sd,
    };
    let receptors = scene.receptors.iter().map(|&(x_mm, y_mm)| Position { x_mm, y_mm }).collect();
    let ours = Scene::new(scene.duration_s, seed, drives.collect(), receptors, model).unwrap();
    let most = 2 + (scene.duration_s / scene.model.refractory_s) as usize;
    scene.offsets = (0..scene.receptors.len() as u64)
        .map(|receptor| {
            let mut noise = Normals::new(seed, receptor);
            (0..most).map(|_| noise_sd * noise.next().clamp(-8.0, 8.0)).collect()
        })
        .collect();
    (scene, ours)
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
