//! The standard scene: 24 motors at 60 Hz, 306 afferents, 1 s.

use meissner_array::pattern::Pattern;
use meissner_skin::Scene;

/// The scene, as a TOML text.
pub const SIXTY_HERTZ: &str = include_str!("../../../scenes/sixty-hertz.toml");

/// Its drives, as a pattern without end.
pub(crate) fn pattern() -> Pattern {
    let scene = Scene::read(SIXTY_HERTZ, "sixty-hertz.toml").expect("a test reads the shipped scene");
    Pattern::new("sixty-hertz", None, scene.drives().to_vec(), toml::Table::new())
        .expect("a test plays the drives of the shipped scene")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scene_has_24_motors_at_60_hz_with_phases_of_their_own() {
        let scene = Scene::read(SIXTY_HERTZ, "sixty-hertz.toml").unwrap();
        assert_eq!((scene.afferents().len(), scene.drives().len(), scene.duration_s()), (306, 24, 1.0));
        assert_eq!(scene.model().noise_sd, meissner_skin::membrane::POPULATION_NOISE_SD);
        assert_eq!(pattern().drives(), scene.drives());
        let mut phases: Vec<_> = scene.drives().iter().map(|drive| drive.phase.to_bits()).collect();
        phases.sort_unstable();
        phases.dedup();
        assert_eq!(phases.len(), 24);
        assert!(scene.drives().iter().all(|drive| (drive.frequency_hz, drive.amplitude_um) == (60.0, 80.0)));
    }
}
