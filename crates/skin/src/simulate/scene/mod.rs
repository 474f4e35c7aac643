//! Scenes: what vibrates, for how long, and which receptors are watched.
//!
//! A scene is read from a TOML or JSON file (`file`) or put together by [`Scene::new`]. Its drives may be faster and
//! larger than a pattern's: a model has no current limit. What comes of it is the simulator's business.
//! All receptors of a scene are of one model. What a motor does may be scaled by a gain, which no file has. Receptors are
//! shared between the scenes that are made of one another: an optimiser makes thousands.
//!
//! Invariant: a [`Scene`] that exists has been checked; every number in it is finite and within its range, and
//! no two drives of a motor overlap.

mod error;
mod file;
mod receptor;

pub use error::{Problem, SceneError};
pub use file::{MAX_JSON_BYTES, MAX_TOML_BYTES};
pub use receptor::{MOST_ALPHA_PER_UM, RawReceptor, check_model};

use crate::afferent::{Position, RaModel};
use error::Fault;
use firmware_protocol::stroke::MOTORS;
use meissner_array::motor::MotorError;
use meissner_array::pattern::{self, Drive};
use meissner_input::document::in_range;
use receptor::seconds;
use std::sync::Arc;

/// A checked scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    duration_s: f64,
    seed: u64,
    drives: Vec<Drive>,
    /// Shared, not copied, by scenes that differ in something else.
    receptors: Arc<Vec<Position>>,
    model: RaModel,
    gains: [f64; MOTORS],
}

/// By what a motor's travel may be multiplied at the most.
pub(super) const MOST_GAIN: f64 = 10.0;
/// Every motor as the model has it.
const NO_GAINS: [f64; MOTORS] = [1.0; MOTORS];

impl Scene {
    /// Makes a scene of its parts.
    ///
    /// # Errors
    /// The first thing that is wrong with it, by the key it would have in a file.
    pub fn new(
        duration_s: f64,
        seed: u64,
        drives: Vec<Drive>,
        receptors: Vec<Position>,
        model: RaModel,
    ) -> Result<Self, SceneError> {
        let receptors = Arc::new(receptors);
        Self { duration_s, seed, drives, receptors, model, gains: NO_GAINS }
            .checked()
            .map_err(|fault| fault.placed(None))
    }

    /// The scene with other drives. Only they are checked: it takes no longer the more receptors there are.
    ///
    /// # Errors
    /// The first thing that is wrong with them, by the key it would have in a file.
    pub fn with_drives(&self, drives: Vec<Drive>) -> Result<Self, SceneError> {
        check_drives(&drives).map_err(|fault| fault.placed(None))?;
        Ok(Self { drives, ..self.clone() })
    }

    /// The scene with all drives of one motor replaced; `drives` must be of that motor.
    ///
    /// # Errors
    /// The first thing that is wrong with it, by the key it would have in a file.
    pub fn with_motor(&self, motor: u8, drives: &[Drive]) -> Result<Self, SceneError> {
        let mut changed: Vec<_> = self.drives.iter().filter(|drive| drive.motor != motor).copied().collect();
        changed.extend(drives.iter().map(|drive| Drive { motor, ..*drive }));
        self.with_drives(changed)
    }

    /// The scene with every motor's travel times its gain, 0 to 10: of 1, nothing changes; of 0, the motor rests. So it
    /// can be asked what is left of a pattern on motors that scatter by 10 %.
    ///
    /// # Errors
    /// The first gain that is out of range.
    pub fn with_gains(&self, gains: &[f64; MOTORS]) -> Result<Self, SceneError> {
        for (motor, &gain) in gains.iter().enumerate() {
            in_range("gains", gain, (0.0..=MOST_GAIN).contains(&gain), "0 to 10")
                .map_err(|fault| Fault { path: format!("gains[{motor}]"), ..fault }.placed(None))?;
        }
        Ok(Self { gains: *gains, ..self.clone() })
    }

    /// Reads a scene file; `file` is what errors call it. A name that ends in `.json` or `.toml` says what it is;
    /// else it is JSON if it begins with a brace.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str) -> Result<Self, SceneError> {
        file::read(text, file).and_then(Self::checked).map_err(|fault| fault.placed(Some(file)))
    }

    /// How long is watched. It only ends the observation: every burst that starts before it exists.
    #[must_use]
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Of the threshold noise.
    #[must_use]
    pub const fn seed(&self) -> u64 {
        self.seed
    }

    /// What the motors do, in the file's order. Every [`Drive::wave`] succeeds.
    #[must_use]
    pub fn drives(&self) -> &[Drive] {
        &self.drives
    }

    /// Where the receptors lie, in the file's order.
    #[must_use]
    pub fn receptors(&self) -> &[Position] {
        &self.receptors
    }

    /// What they are made of.
    #[must_use]
    pub const fn model(&self) -> &RaModel {
        &self.model
    }

    /// The scene without drives, for motors that others move, by so much more or less than a model's. Nobody looks for
    /// a period of what has none.
    pub(super) fn moved_otherwise(&self, gains: [f64; MOTORS]) -> Self {
        Self { drives: Vec::new(), gains, ..self.clone() }
    }

    /// By what each motor's travel is multiplied.
    pub(super) const fn gains(&self) -> &[f64; MOTORS] {
        &self.gains
    }

    fn checked(self) -> Result<Self, Fault> {
        seconds("duration_s", self.duration_s)?;
        check_drives(&self.drives)?;
        check_receptors(&self.receptors)?;
        check_model(&self.model).map_err(|fault| fault.within("receptor"))?;
        Ok(self)
    }
}

/// What a motor's number must be, also where it does not fit the number's type.
const MOTOR_RANGE: &str = "0 to 23";

fn check_drives(drives: &[Drive]) -> Result<(), Fault> {
    for (index, drive) in drives.iter().enumerate() {
        check_drive(drive).map_err(|fault| fault.within(&format!("drives[{index}]")))?;
    }
    let Some((first, second)) = pattern::overlap(drives) else { return Ok(()) };
    let later = &drives[second];
    let problem = Problem::Overlap { motor: later.motor, other: first, start_s: later.start() };
    Err(Fault::key("motor", problem).within(&format!("drives[{second}]")))
}

fn check_receptors(receptors: &[Position]) -> Result<(), Fault> {
    for (index, at) in receptors.iter().enumerate() {
        for (key, found) in [("x_mm", at.x_mm), ("y_mm", at.y_mm)] {
            in_range(key, found, found.abs() <= 1e6, "-1000000 to 1000000 mm")
                .map_err(|fault| fault.within(&format!("receptors[{index}]")))?;
        }
    }
    Ok(())
}

fn check_drive(drive: &Drive) -> Result<(), Fault> {
    in_range("motor", drive.motor.into(), usize::from(drive.motor) < MOTORS, MOTOR_RANGE)?;
    drive.wave().map_err(|source| {
        let key = match source {
            MotorError::Frequency { .. } => "frequency_hz",
            MotorError::Amplitude { .. } => "amplitude_um",
            MotorError::Phase { .. } => "phase",
        };
        Fault::key(key, Problem::Wave(source))
    })?;
    for (key, time) in [("start_s", drive.start_s), ("stop_s", drive.stop_s)] {
        time.map_or(Ok(()), |found| seconds(key, found))?;
    }
    match drive.stop_s {
        Some(stop_s) if stop_s <= drive.start() => {
            Err(Fault::key("stop_s", Problem::StopsBeforeStart { start_s: drive.start(), stop_s }))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::afferent::Rectify;

    const DRIVE: Drive =
        Drive { motor: 3, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.0, start_s: None, stop_s: None };

    fn scene(drives: Vec<Drive>, model: RaModel) -> Result<Scene, String> {
        let receptors = vec![Position { x_mm: 0.0, y_mm: -0.0 }];
        Scene::new(1.0, 7, drives, receptors, model).map_err(|error| error.to_string())
    }

    #[test]
    fn what_is_built_is_kept_as_it_is() {
        let model = RaModel::default_for(Rectify::Full, 0.05);
        let after = Drive { start_s: Some(0.5), ..DRIVE };
        let before = Drive { stop_s: Some(0.5), ..DRIVE };
        let drives = vec![after, before, Drive { motor: 4, frequency_hz: 42_500.0, ..DRIVE }];
        let scene = scene(drives.clone(), model).unwrap();
        assert_eq!((scene.duration_s(), scene.seed(), scene.drives()), (1.0, 7, &drives[..]));
        assert_eq!((scene.receptors().len(), scene.model()), (1, &model));
        Scene::new(0.0, 0, vec![], vec![], model).unwrap();
    }

    #[test]
    fn a_built_scene_is_checked_as_a_read_one() {
        let model = RaModel::default_for(Rectify::Half, 0.0);
        let line = scene(vec![Drive { motor: 24, ..DRIVE }], model).unwrap_err();
        assert_eq!(line, "`drives[0].motor` is 24: must be 0 to 23");
        let line = scene(vec![DRIVE, DRIVE], model).unwrap_err();
        assert!(line.starts_with("`drives[1].motor`: motor 3 is still driven by drives[0]"), "{line}");
        let line = scene(vec![], RaModel { tau_s: f64::NAN, ..model }).unwrap_err();
        assert_eq!(line, "`receptor.tau_s` is NaN: must be 1e-9 to 1e9 s");
        let line = Scene::new(f64::INFINITY, 0, vec![], vec![], model).unwrap_err().to_string();
        assert_eq!(line, "`duration_s` is inf: must be 0 to 1000000000 s");
    }

    #[test]
    fn what_is_changed_of_a_scene_is_checked_and_the_rest_stays() {
        let scene = scene(vec![DRIVE], RaModel::default_for(Rectify::Half, 0.05)).unwrap();
        let mut gains = [1.0; MOTORS];
        assert_eq!(scene.with_gains(&gains).unwrap(), scene);
        for wrong in [-0.1, 10.1, f64::NAN, f64::INFINITY] {
            gains[23] = wrong;
            let line = scene.with_gains(&gains).unwrap_err().to_string();
            assert_eq!(line, format!("`gains[23]` is {wrong}: must be 0 to 10"));
        }
        gains[23] = 10.0;
        let scene = scene.with_gains(&gains).unwrap();
        let line = scene.with_drives(vec![DRIVE, DRIVE]).unwrap_err().to_string();
        assert!(line.starts_with("`drives[1].motor`: motor 3 is still driven by drives[0]"), "{line}");
        let at_rest = scene.with_drives(vec![]).unwrap();
        assert_eq!(
            (at_rest.drives().len(), at_rest.receptors(), at_rest.gains()),
            (0, scene.receptors(), &gains)
        );
    }
}
