//! A finger of either model, which responds to moving pins with spikes.
//!
//! [`Finger::new`] places the afferents of a fingertip; [`Finger::spikes_s`] and [`Finger::counts`] compute the response to a
//! [`Stimulus`]: drives of a pattern or the bursts that motors made, for some time, with some noise. The first model is simulated
//! exactly.
//!
//! Invariant: the RA afferents of both models lie at the same places and come first.

use crate::afferents::{self, Afferent, Class};
use crate::membrane::{self, AfferentModel, Position};
use crate::method::{Keep, Method, MethodError, Options};
use crate::ramps::{Ramps, RampsError, simulate_ramps};
use crate::scene::{ModelName, Scene, SceneError};
use crate::simulation::simulate;
use meissner_array::pattern::Drive;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;

/// A model of the skin and its afferents, with its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SkinModel {
    /// The first: RA afferents with a leaky membrane.
    Membrane(AfferentModel),
    /// The second: skin mechanics, and SA1, RA and PC afferents with noise.
    Afferents {
        /// By how much the pins are pressed in, mm: [`afferents::PREINDENT_MM`].
        preindent_mm: f64,
    },
}

/// The afferents of one finger.
#[derive(Clone, Debug, PartialEq)]
pub struct Finger {
    model: SkinModel,
    afferents: Vec<Afferent>,
}

/// What moves the pins.
#[derive(Clone, Copy, Debug)]
pub enum Moved<'m> {
    /// The drives of a pattern.
    Drives {
        /// The array that the pattern is for.
        array: Array,
        /// The drives.
        drives: &'m [Drive],
        /// The gain of the motors that play them: 1 is the model's.
        gain: f64,
    },
    /// The bursts that motors made, at the gains they had.
    Ramps(&'m Ramps),
}

/// A stimulus of a finger. Pins and afferents are at rest at its beginning.
#[derive(Clone, Copy, Debug)]
pub struct Stimulus<'m> {
    /// What moves the pins.
    pub moved: Moved<'m>,
    /// Duration, s.
    pub duration_s: f64,
    /// Seed of the noise. Trials of one seed have the same noise.
    pub noise_seed: u64,
}

/// Why a finger's response cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FingerError {
    /// No scene can have such afferents, drives or duration.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// It cannot be simulated.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// No motor can make such bursts.
    #[error(transparent)]
    Ramps(#[from] RampsError),
}

impl SkinModel {
    /// The second model, with pins pressed in as by default.
    pub const AFFERENTS: Self = Self::Afferents { preindent_mm: afferents::PREINDENT_MM };

    /// The model with this name; `membrane` holds the parameters of the first model.
    #[must_use]
    pub const fn of(name: ModelName, membrane: AfferentModel) -> Self {
        match name {
            ModelName::Membrane => Self::Membrane(membrane),
            ModelName::Afferents => Self::AFFERENTS,
        }
    }

    /// Its name.
    #[must_use]
    pub const fn name(&self) -> ModelName {
        match self {
            Self::Membrane(_) => ModelName::Membrane,
            Self::Afferents { .. } => ModelName::Afferents,
        }
    }

    /// The classes of its afferents.
    #[must_use]
    pub const fn classes(&self) -> &'static [Class] {
        match self {
            Self::Membrane(_) => &[Class::Ra],
            Self::Afferents { .. } => &Class::ALL,
        }
    }
}

impl<'m> Stimulus<'m> {
    /// Drives of an array for some time, on ideal motors.
    #[must_use]
    pub const fn of_drives(array: Array, drives: &'m [Drive], duration_s: f64, noise_seed: u64) -> Self {
        Self { moved: Moved::Drives { array, drives, gain: 1.0 }, duration_s, noise_seed }
    }

    /// Bursts for some time.
    #[must_use]
    pub const fn of_ramps(ramps: &'m Ramps, duration_s: f64, noise_seed: u64) -> Self {
        Self { moved: Moved::Ramps(ramps), duration_s, noise_seed }
    }
}

impl Finger {
    /// The fingertip of a seed: 306 RA afferents, and in the second model 200 SA1 and 60 PC.
    #[must_use]
    pub fn new(model: SkinModel, seed: u64) -> Self {
        let afferents = match model {
            SkinModel::Membrane(_) => membrane::population(seed).into_iter().map(rapid).collect(),
            SkinModel::Afferents { .. } => afferents::population(seed),
        };
        Self { model, afferents }
    }

    /// Some afferents. In the first model all must be RA, and their rows are ignored.
    ///
    /// # Panics
    /// If an afferent of the first model is of another class.
    #[must_use]
    pub fn of_afferents(model: SkinModel, afferents: Vec<Afferent>) -> Self {
        let known = afferents.iter().all(|afferent| model.classes().contains(&afferent.class));
        assert!(known, "the first model has RA afferents alone");
        Self { model, afferents }
    }

    /// The finger with the afferents of one class alone.
    #[must_use]
    pub fn only(mut self, class: Class) -> Self {
        self.afferents.retain(|afferent| afferent.class == class);
        self
    }

    /// The finger shifted on the array.
    #[must_use]
    pub fn shifted(mut self, [x_mm, y_mm]: [f64; 2]) -> Self {
        for Afferent { at, .. } in &mut self.afferents {
            *at = Position { x_mm: at.x_mm + x_mm, y_mm: at.y_mm + y_mm };
        }
        self
    }

    /// The model.
    #[must_use]
    pub const fn model(&self) -> &SkinModel {
        &self.model
    }

    /// The afferents.
    #[must_use]
    pub fn afferents(&self) -> &[Afferent] {
        &self.afferents
    }

    /// The numbers of the afferents of a class.
    pub fn of_class(&self, class: Class) -> impl Iterator<Item = usize> {
        self.afferents.iter().enumerate().filter(move |(_, of)| of.class == class).map(|(number, _)| number)
    }

    /// Each afferent's spikes in order, s.
    ///
    /// # Errors
    /// If no scene can have such drives or such a duration, or if there are too many spikes to keep.
    pub fn spikes_s(&self, stimulus: &Stimulus<'_>) -> Result<Vec<Vec<f64>>, FingerError> {
        match (&self.model, stimulus.moved) {
            (SkinModel::Membrane(model), Moved::Drives { array, drives, gain }) => {
                let scene = self.motors(stimulus, (array, drives, gain), self.places(), *model)?;
                let answer = simulate(&scene, &Options::spikes(Method::Exact), &|_| ())?;
                Ok(answer.spikes_s.expect("spikes are kept"))
            }
            (SkinModel::Membrane(model), Moved::Ramps(ramps)) => {
                let scene = self.motors(stimulus, (ramps.array(), &[], 1.0), self.places(), *model)?;
                let mut spikes_s = vec![Vec::new(); self.afferents.len()];
                simulate_ramps(&scene, ramps, &mut |number, train| spikes_s[number as usize] = train)?;
                Ok(spikes_s)
            }
            (SkinModel::Afferents { preindent_mm }, _) => {
                let scene = self.scene(stimulus, *preindent_mm)?;
                let answer = afferents::simulate(&scene, Keep::Spikes, &|_| ())?;
                Ok(answer.spikes_s.expect("spikes are kept"))
            }
        }
    }

    /// Each afferent's number of spikes.
    ///
    /// # Errors
    /// If no scene can have such drives or such a duration.
    pub fn counts(&self, stimulus: &Stimulus<'_>) -> Result<Vec<u64>, FingerError> {
        match (&self.model, stimulus.moved) {
            (SkinModel::Membrane(model), Moved::Drives { array, drives, gain }) => {
                let scene = self.motors(stimulus, (array, drives, gain), self.places(), *model)?;
                Ok(simulate(&scene, &Options::rates(Method::Exact), &|_| ())?.counts)
            }
            (SkinModel::Membrane(_), Moved::Ramps(_)) => {
                Ok(self.spikes_s(stimulus)?.iter().map(|train| train.len() as u64).collect())
            }
            (SkinModel::Afferents { preindent_mm }, _) => {
                let scene = self.scene(stimulus, *preindent_mm)?;
                Ok(afferents::simulate(&scene, Keep::Rates, &|_| ())?.counts)
            }
        }
    }

    fn places(&self) -> Vec<Position> {
        self.afferents.iter().map(|afferent| afferent.at).collect()
    }

    fn motors(
        &self,
        stimulus: &Stimulus<'_>,
        (array, drives, gain): (Array, &[Drive], f64),
        places: Vec<Position>,
        model: AfferentModel,
    ) -> Result<Scene, SceneError> {
        Scene::new(array, stimulus.duration_s, stimulus.noise_seed, drives.to_vec(), places, model)?
            .with_gains(&PerMotor::all(array, gain))
    }

    /// A scene of the second model.
    fn scene(&self, stimulus: &Stimulus<'_>, preindent_mm: f64) -> Result<afferents::Scene, SceneError> {
        let Stimulus { duration_s, noise_seed, .. } = *stimulus;
        let afferents = self.afferents.clone();
        match stimulus.moved {
            Moved::Drives { array, drives, gain } => {
                let unused = AfferentModel::default_for(membrane::Rectify::default(), 0.0);
                let motors = self.motors(stimulus, (array, drives, gain), Vec::new(), unused)?;
                afferents::Scene::of_motors(&motors, preindent_mm, afferents, true)
            }
            Moved::Ramps(ramps) => {
                afferents::Scene::of_ramps(ramps, duration_s, noise_seed, preindent_mm, afferents, true)
            }
        }
    }
}

/// An afferent of the first model.
const fn rapid(at: Position) -> Afferent {
    Afferent { class: Class::Ra, row: 0, at }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::membrane::{POPULATION_NOISE_SD, Rectify};
    use meissner_array::motor::Ramp;
    use meissner_array::pattern::Pattern;
    use meissner_array::strokes::{StrokeOptions, Strokes};
    use meissner_test_support::paper::UM_PER_PULSE;
    use meissner_test_support::patterns::drive;

    fn models() -> [SkinModel; 2] {
        let membrane = AfferentModel::default_for(Rectify::default(), POPULATION_NOISE_SD);
        [ModelName::Membrane, ModelName::Afferents].map(|name| SkinModel::of(name, membrane))
    }

    /// The bursts of a second of drives, with their travel multiplied by `share`; a stimulus of half a second needs only a part.
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

    #[test]
    fn bursts_that_travel_as_designed_give_the_spikes_of_the_drives() {
        let drives = [drive(9, 60.0, 80.0), drive(14, 37.3, 120.0), drive(0, 150.0, 30.0)];
        for model in models() {
            let finger = Finger::new(model, 4);
            let designed = finger.spikes_s(&Stimulus::of_drives(Array::paper(), &drives, 0.5, 4)).unwrap();
            assert!(designed.iter().map(Vec::len).sum::<usize>() > 300, "{model:?}");
            let ramps = ramps(&drives, 1.0);
            let stimulus = Stimulus::of_ramps(&ramps, 0.5, 4);
            assert!(finger.spikes_s(&stimulus).unwrap() == designed, "{model:?}");
            let counts: Vec<u64> = designed.iter().map(|train| train.len() as u64).collect();
            assert_eq!(finger.counts(&stimulus).unwrap(), counts);
            assert_eq!(finger.counts(&Stimulus::of_drives(Array::paper(), &drives, 0.5, 4)).unwrap(), counts);
        }
    }

    /// A gain of all motors has the same effect as shorter travels: both lower the response.
    #[test]
    fn slower_bursts_are_motors_of_a_lower_gain() {
        let drives = [drive(9, 60.0, 80.0)];
        for model in models() {
            let finger = Finger::new(model, 4);
            let total = |stimulus: &Stimulus<'_>| finger.counts(stimulus).unwrap().iter().sum::<u64>();
            let slow = ramps(&drives, 0.5);
            let slow = total(&Stimulus::of_ramps(&slow, 0.5, 4));
            let gained = total(&Stimulus {
                moved: Moved::Drives { array: Array::paper(), drives: &drives, gain: 0.5 },
                ..Stimulus::of_drives(Array::paper(), &drives, 0.5, 4)
            });
            assert_eq!(slow, gained, "{model:?}");
            let whole = total(&Stimulus::of_drives(Array::paper(), &drives, 0.5, 4));
            assert!(slow > 0 && 10 * slow < 9 * whole, "{model:?}: {slow} of {whole}");
        }
    }

    #[test]
    fn both_models_have_the_same_rapid_afferents_and_shift_alike() {
        let [membrane, afferents] = models().map(|model| Finger::new(model, 7).shifted([1.0, -2.0]));
        let places = |finger: &Finger| {
            finger.of_class(Class::Ra).map(|number| finger.afferents()[number].at).collect::<Vec<_>>()
        };
        assert_eq!(places(&membrane), places(&afferents));
        assert_eq!((membrane.afferents().len(), afferents.afferents().len()), (306, 566));
        let at = membrane::population(7)[5];
        assert_eq!(places(&membrane)[5], Position { x_mm: at.x_mm + 1.0, y_mm: at.y_mm - 2.0 });
        assert_eq!(afferents.of_class(Class::Pc).count(), 60);
    }

    /// An amplitude of 300 um lifts neighbouring pins off the skin, because pins are pressed in by only 50 um.
    #[test]
    fn lost_contact_changes_the_answer_to_bursts_as_to_drives() {
        let drives = [drive(9, 60.0, 300.0)];
        let ramps = ramps(&drives, 1.0);
        let rates = |preindent_mm| {
            let finger = Finger::new(SkinModel::Afferents { preindent_mm }, 4);
            let designed = finger.counts(&Stimulus::of_drives(Array::paper(), &drives, 0.5, 4)).unwrap();
            assert_eq!(finger.counts(&Stimulus::of_ramps(&ramps, 0.5, 4)).unwrap(), designed);
            designed
        };
        assert_ne!(rates(0.05), rates(0.5));
    }
}
