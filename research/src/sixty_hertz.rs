//! The drives of the standard scene: all motors at 60 Hz.

use meissner_array::pattern::Pattern;
use meissner_skin::Scene;

/// The drives, as a pattern without end.
pub(crate) fn pattern() -> Pattern {
    let scene = Scene::read(include_str!("../../library/scenes/sixty-hertz.toml"), "sixty-hertz.toml")
        .expect("a test reads the shipped scene");
    Pattern::new(scene.array(), "sixty-hertz", None, scene.drives().to_vec(), toml::Table::new())
        .expect("a test plays the drives of the shipped scene")
}
