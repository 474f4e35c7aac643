//! Makes one scene for the oracle and for the simulator.

use crate::oracle;
use meissner_array::pattern::Drive;
use meissner_array::random::Normals;
use meissner_skin::Scene;
use meissner_skin::afferent::{AfferentModel, Position, Rectify};

/// Turns an oracle's scene into one of the simulator's, and draws its noise for the oracle.
pub fn both(mut scene: oracle::Scene, noise_sd: f64, seed: u64) -> (oracle::Scene, Scene) {
    let drives = scene.drives.iter().map(|drive| Drive {
        motor: drive.motor as u8,
        frequency_hz: drive.frequency_hz,
        amplitude_um: drive.amplitude_um,
        phase: drive.phase,
        start_s: Some(drive.start_s),
        stop_s: drive.stop_s,
    });
    let model = AfferentModel {
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
    let afferents = scene.afferents.iter().map(|&(x_mm, y_mm)| Position { x_mm, y_mm }).collect();
    let ours = Scene::new(scene.duration_s, seed, drives.collect(), afferents, model).unwrap();
    let most = 2 + (scene.duration_s / scene.model.refractory_s) as usize;
    scene.offsets = (0..scene.afferents.len() as u64)
        .map(|afferent| {
            let mut noise = Normals::new(seed, afferent);
            (0..most).map(|_| noise_sd * noise.next().clamp(-8.0, 8.0)).collect()
        })
        .collect();
    (scene, ours)
}
