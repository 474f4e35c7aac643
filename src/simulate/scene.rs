//! Scenes: what vibrates, for how long, and which receptors are watched.
//!
//! A scene is read from a TOML or JSON file (`file`) or put together by [`Scene::new`]. Its drives may be faster and
//! larger than a pattern's: a model has no current limit. What comes of it is the simulator's business.
//! All receptors of a scene are of one model.
//!
//! Invariant: a [`Scene`] that exists has been checked; every number in it is finite and within its range, and
//! no two drives of a motor overlap.

mod error;
mod file;
mod receptor;

pub use error::{Problem, SceneError};
pub use file::{MAX_JSON_BYTES, MAX_TOML_BYTES};
pub(crate) use receptor::{RawReceptor, check_model};

use crate::keyed::in_range;
use crate::motor::MotorError;
use crate::pattern::{self, Drive};
use crate::skin::{Position, RaModel};
use error::Fault;
use firmware_protocol::stroke::MOTORS;
use receptor::seconds;

/// A checked scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    duration_s: f64,
    seed: u64,
    drives: Vec<Drive>,
    receptors: Vec<Position>,
    model: RaModel,
}

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
        Self { duration_s, seed, drives, receptors, model }
            .checked()
            .map_err(|fault| SceneError::new(fault, None))
    }

    /// The scene with all drives of one motor replaced; `drives` must be of that motor.
    ///
    /// # Errors
    /// The first thing that is wrong with it, by the key it would have in a file.
    pub fn with_motor(&self, motor: u8, drives: &[Drive]) -> Result<Self, SceneError> {
        let mut scene = self.clone();
        scene.drives.retain(|drive| drive.motor != motor);
        scene.drives.extend(drives.iter().map(|drive| Drive { motor, ..*drive }));
        scene.checked().map_err(|fault| SceneError::new(fault, None))
    }

    /// Reads a scene file; `file` is what errors call it. A name that ends in `.json` or `.toml` says what it is;
    /// else it is JSON if it begins with a brace.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str) -> Result<Self, SceneError> {
        file::read(text, file).and_then(Self::checked).map_err(|fault| SceneError::new(fault, Some(file)))
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

    fn checked(self) -> Result<Self, Fault> {
        seconds("duration_s", self.duration_s)?;
        for (index, drive) in self.drives.iter().enumerate() {
            check_drive(drive).map_err(|fault| fault.within(&format!("drives[{index}]")))?;
        }
        if let Some((first, second)) = pattern::overlap(&self.drives) {
            let later = &self.drives[second];
            let problem = Problem::Overlap { motor: later.motor, other: first, start_s: later.start() };
            return Err(Fault::key("motor", problem).within(&format!("drives[{second}]")));
        }
        for (index, at) in self.receptors.iter().enumerate() {
            for (key, found) in [("x_mm", at.x_mm), ("y_mm", at.y_mm)] {
                in_range(key, found, found.abs() <= 1e6, "-1000000 to 1000000 mm")
                    .map_err(|fault| fault.within(&format!("receptors[{index}]")))?;
            }
        }
        check_model(&self.model).map_err(|fault| fault.within("receptor"))?;
        Ok(self)
    }
}

/// What a motor's number must be, also where it does not fit the number's type.
const MOTOR_RANGE: &str = "0 to 23";

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
    use crate::skin::Rectify;

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
}
