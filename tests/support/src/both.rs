//! Makes one scene for the oracle and for the simulator.

use crate::oracle;
use meissner_array::pattern::Drive;
use meissner_array::random::Normals;
use meissner_array::spec::Array;
use meissner_skin::Scene;
use meissner_skin::membrane::{AfferentModel, Position, Rectify};

/// Turns an oracle's scene into one of the simulator's, and draws its noise for the oracle.
pub fn both(scene: oracle::Scene, noise_sd: f64, seed: u64) -> (oracle::Scene, Scene) {
    let drives = scene.drives.iter().map(|drive| Drive {
        motor: drive.motor as u8,
        frequency_hz: drive.frequency_hz,
        amplitude_um: drive.amplitude_um,
        phase: drive.phase,
        start_s: Some(drive.start_s),
        stop_s: drive.stop_s,
    });
    let oracle::Model { alpha_per_um, tau_s, refractory_s, hyperexcitability_s, .. } = scene.model;
    let oracle::Model { hyperexcitability_depth, sigma_mm, .. } = scene.model;
    let rectify = match scene.model.rectify {
        oracle::Rectify::Half => Rectify::Half,
        oracle::Rectify::Full => Rectify::Full,
        oracle::Rectify::Signed => Rectify::Signed,
    };
    let model = AfferentModel {
        rectify,
        alpha_per_um,
        tau_s,
        refractory_s,
        hyperexcitability_s,
        hyperexcitability_depth,
        sigma_mm,
        noise_sd,
    };
    let afferents = scene.afferents.iter().map(|&(x_mm, y_mm)| Position { x_mm, y_mm }).collect();
    let array = Array::named(scene.array.name).unwrap();
    let ours = Scene::new(array, scene.duration_s, seed, drives.collect(), afferents, model).unwrap();
    (for_oracle(&ours), ours)
}

/// The scene for the oracle, with its noise drawn.
pub fn for_oracle(scene: &Scene) -> oracle::Scene {
    let drive = |drive: &Drive| oracle::Drive {
        motor: drive.motor.into(),
        frequency_hz: drive.frequency_hz,
        amplitude_um: drive.amplitude_um,
        phase: drive.phase,
        start_s: drive.start_s.unwrap_or(0.0),
        stop_s: drive.stop_s,
    };
    let model = scene.model();
    let most = 2 + (scene.duration_s() / model.refractory_s) as usize;
    let offsets = |afferent: usize| {
        let mut noise = Normals::new(scene.seed(), afferent as u64);
        (0..most).map(|_| model.noise_sd * noise.next().clamp(-8.0, 8.0)).collect()
    };
    let of_name = |array: &oracle::Array| array.name == scene.array().name();
    oracle::Scene {
        array: oracle::Array::shipped().into_iter().find(of_name).unwrap(),
        duration_s: scene.duration_s(),
        drives: scene.drives().iter().map(drive).collect(),
        afferents: scene.afferents().iter().map(|at| (at.x_mm, at.y_mm)).collect(),
        offsets: (0..scene.afferents().len()).map(offsets).collect(),
        model: oracle::Model {
            rectify: match model.rectify {
                Rectify::Half => oracle::Rectify::Half,
                Rectify::Full => oracle::Rectify::Full,
                Rectify::Signed => oracle::Rectify::Signed,
            },
            alpha_per_um: model.alpha_per_um,
            tau_s: model.tau_s,
            refractory_s: model.refractory_s,
            hyperexcitability_s: model.hyperexcitability_s,
            hyperexcitability_depth: model.hyperexcitability_depth,
            sigma_mm: model.sigma_mm,
        },
    }
}
