//! The standard scene: all motors of the paper's array at 60 Hz, 306 afferents, 1 s.

/// The scene, as a TOML text.
pub const SIXTY_HERTZ: &str = include_str!("../../../scenes/sixty-hertz.toml");

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_skin::Scene;

    #[test]
    fn the_scene_has_24_motors_at_60_hz_with_phases_of_their_own() {
        let scene = Scene::read(SIXTY_HERTZ, "sixty-hertz.toml").unwrap();
        assert_eq!((scene.afferents().len(), scene.drives().len(), scene.duration_s()), (306, 24, 1.0));
        assert_eq!(scene.model().noise_sd, meissner_skin::membrane::POPULATION_NOISE_SD);
        let mut phases: Vec<_> = scene.drives().iter().map(|drive| drive.phase.to_bits()).collect();
        phases.sort_unstable();
        phases.dedup();
        assert_eq!(phases.len(), 24);
        assert!(scene.drives().iter().all(|drive| (drive.frequency_hz, drive.amplitude_um) == (60.0, 80.0)));
    }
}
