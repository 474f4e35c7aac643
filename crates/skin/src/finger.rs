//! A finger on the pins: it responds to moving pins with spikes.
//!
//! [`Finger::new`] places the afferents of a fingertip; [`Finger::spikes_s`] computes their response to the bursts of motors.

use crate::afferents::{Afferent, Class, PREINDENT_MM, Scene, population, simulate};
use crate::membrane::Position;
use crate::method::{Keep, MethodError};
use crate::ramps::{Ramps, RampsError};
use crate::scene::SceneError;

/// The afferents of one finger.
#[derive(Clone, Debug, PartialEq)]
pub struct Finger {
    preindent_mm: f64,
    afferents: Vec<Afferent>,
}

/// Why a finger's response cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FingerError {
    /// No scene can have such afferents or such a duration.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// It cannot be simulated.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// No motor can make such bursts.
    #[error(transparent)]
    Ramps(#[from] RampsError),
}

impl Finger {
    /// The fingertip of a seed: 306 RA afferents, 200 SA1 and 60 PC.
    pub fn new(seed: u64) -> Self {
        Self { preindent_mm: PREINDENT_MM, afferents: population(seed) }
    }

    /// The finger with the pins pressed in by so much, mm.
    pub fn pressed(self, preindent_mm: f64) -> Self {
        Self { preindent_mm, ..self }
    }

    /// The finger shifted on the array.
    pub fn shifted(mut self, [x_mm, y_mm]: [f64; 2]) -> Self {
        for Afferent { at, .. } in &mut self.afferents {
            *at = Position { x_mm: at.x_mm + x_mm, y_mm: at.y_mm + y_mm };
        }
        self
    }

    /// The afferents.
    pub fn afferents(&self) -> &[Afferent] {
        &self.afferents
    }

    /// The numbers of the afferents of a class.
    pub fn of_class(&self, class: Class) -> impl Iterator<Item = usize> {
        self.afferents.iter().enumerate().filter(move |(_, of)| of.class == class).map(|(number, _)| number)
    }

    /// Each afferent's spikes in order, s, while motors make these bursts. Pins and afferents are at rest at the beginning; responses
    /// of one `noise_seed` have the same noise.
    ///
    /// # Errors
    /// If no scene can have such a duration, or if there are too many spikes to keep.
    pub fn spikes_s(
        &self,
        ramps: &Ramps,
        duration_s: f64,
        noise_seed: u64,
    ) -> Result<Vec<Vec<f64>>, FingerError> {
        let afferents = self.afferents.clone();
        let scene = Scene::of_ramps(ramps, duration_s, noise_seed, self.preindent_mm, afferents)?;
        Ok(simulate(&scene, Keep::Spikes, &|_| ())?.spikes_s.expect("spikes are kept"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AnyScene, ModelName};
    use meissner_array::motor::Ramp;
    use meissner_array::pattern::{Drive, Pattern};
    use meissner_array::spec::Array;
    use meissner_array::strokes::{StrokeOptions, Strokes};
    use meissner_test_support::paper::UM_PER_PULSE;
    use meissner_test_support::patterns::drive;
    use serde_json::json;

    /// The bursts of a second of drives, with their travel multiplied by `share`.
    fn ramps(drives: &[Drive], share: f64) -> Ramps {
        let pattern =
            Pattern::new(Array::paper(), "test", None, drives.to_vec(), toml::Table::new()).unwrap();
        let strokes = Strokes::new(&pattern, &StrokeOptions::lasting(1.0)).unwrap().map(Result::unwrap);
        let ramp = |burst: meissner_array::strokes::Burst| {
            Ramp::new(burst.start, burst.pulses.into(), burst.direction, share * UM_PER_PULSE)
        };
        Ramps::new(
            Array::paper(),
            strokes.flat_map(|step| step.bursts().map(move |burst| (step.motor(), ramp(burst)))),
        )
        .unwrap()
    }

    /// Half a second needs only a part of the bursts. An amplitude of 300 um lifts neighbouring pins off the skin that are pressed in
    /// by only 50 um.
    #[test]
    fn bursts_that_travel_as_designed_give_the_spikes_of_the_drives() {
        let drives = [drive(9, 60.0, 300.0), drive(14, 37.3, 120.0), drive(0, 150.0, 30.0)];
        let spikes_s = [0.05, 0.5].map(|preindent_mm| {
            let scene = json!({
                "duration_s": 0.5, "seed": 4, "preindent_mm": preindent_mm, "population": {"seed": 4}, "drives": drives
            });
            let scene = AnyScene::read(&scene.to_string(), "a.json", Some(ModelName::Afferents));
            let Ok(AnyScene::Afferents(scene)) = scene else { panic!("{scene:?}") };
            let designed = simulate(&scene, Keep::Spikes, &|_| ()).unwrap().spikes_s.unwrap();
            assert!(designed.iter().map(Vec::len).sum::<usize>() > 300);
            let finger = Finger::new(4).pressed(preindent_mm);
            assert!(finger.spikes_s(&ramps(&drives, 1.0), 0.5, 4).unwrap() == designed);
            designed
        });
        assert_ne!(spikes_s[0], spikes_s[1]);
    }
}
