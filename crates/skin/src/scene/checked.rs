//! A [`Scene`], its checks, and scenes made from it.

use super::afferent::{check_model, seconds};
use super::error::{KeyError, Problem, SceneError};
use crate::membrane::{AfferentModel, Position};
use meissner_array::motor::MotorError;
use meissner_array::pattern::{self, Drive};
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_input::document::in_range;
use std::sync::Arc;

/// A checked scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    pub(super) array: Array,
    pub(super) duration_s: f64,
    pub(super) seed: u64,
    pub(super) drives: Vec<Drive>,
    /// Shared by scenes that have the same afferents.
    pub(super) afferents: Arc<Vec<Position>>,
    pub(super) model: AfferentModel,
    pub(super) gains: PerMotor<f64>,
}

/// The largest gain of a motor's travel.
pub(crate) const MAX_GAIN: f64 = 10.0;

impl Scene {
    /// Makes a scene of the motors of an array. `afferents` are their positions; `seed` is that of the threshold noise.
    ///
    /// # Errors
    /// The first thing that is wrong with it, by the key it would have in a file.
    pub fn new(
        array: Array,
        duration_s: f64,
        seed: u64,
        drives: Vec<Drive>,
        afferents: Vec<Position>,
        model: AfferentModel,
    ) -> Result<Self, SceneError> {
        let (afferents, gains) = (Arc::new(afferents), ideal(array));
        Self { array, duration_s, seed, drives, afferents, model, gains }
            .checked()
            .map_err(|fault| fault.in_file(None))
    }

    /// The scene with other drives. Only the drives are checked, so the time does not depend on the number of afferents.
    ///
    /// # Errors
    /// The first thing that is wrong with them, by the key it would have in a file.
    pub fn with_drives(&self, drives: Vec<Drive>) -> Result<Self, SceneError> {
        check_drives(self.array, &drives).map_err(|fault| fault.in_file(None))?;
        Ok(Self { drives, ..self.clone() })
    }

    /// The scene with every motor's travel multiplied by its gain, 0 to 10. With a gain of 1 nothing changes; with 0 the
    /// motor rests. This shows what remains of a pattern on motors that scatter by 10 %.
    ///
    /// # Errors
    /// The first gain that is out of range.
    ///
    /// # Panics
    /// If there are more or fewer gains than motors.
    pub fn with_gains(&self, gains: &PerMotor<f64>) -> Result<Self, SceneError> {
        assert_eq!(gains.len(), self.array.motors(), "a motor has a gain");
        for (motor, &gain) in gains.iter().enumerate() {
            in_range("gains", gain, (0.0..=MAX_GAIN).contains(&gain), "0 to 10")
                .map_err(|fault| KeyError { path: format!("gains[{motor}]"), ..fault }.in_file(None))?;
        }
        Ok(Self { gains: *gains, ..self.clone() })
    }

    /// The array whose motors move the pins.
    pub const fn array(&self) -> Array {
        self.array
    }

    /// The simulated time, s. It only ends the observation: every burst that starts before it takes place.
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// The seed of the threshold noise.
    pub const fn seed(&self) -> u64 {
        self.seed
    }

    /// The drives of the motors, in the file's order. Every [`Drive::wave`] succeeds.
    pub fn drives(&self) -> &[Drive] {
        &self.drives
    }

    /// The positions of the afferents, in the file's order.
    pub fn afferents(&self) -> &[Position] {
        &self.afferents
    }

    /// The parameters of the afferents.
    pub const fn model(&self) -> &AfferentModel {
        &self.model
    }

    /// The scene without drives, for motors that ramps move, with these gains.
    pub(crate) fn without_drives(&self, gains: PerMotor<f64>) -> Self {
        Self { drives: Vec::new(), gains, ..self.clone() }
    }

    /// The gain of each motor's travel.
    pub(crate) const fn gains(&self) -> &PerMotor<f64> {
        &self.gains
    }

    /// Impulses per second of an afferent with `count` spikes; 0 in a scene without duration.
    pub(crate) fn rate_hz(&self, count: u64) -> f64 {
        if count == 0 { 0.0 } else { count as f64 / self.duration_s }
    }

    pub(super) fn checked(self) -> Result<Self, KeyError> {
        seconds("duration_s", self.duration_s)?;
        check_drives(self.array, &self.drives)?;
        check_afferents(&self.afferents)?;
        check_model(&self.model).map_err(|fault| fault.within("afferent"))?;
        Ok(self)
    }
}

/// The gains of ideal motors.
pub(super) fn ideal(array: Array) -> PerMotor<f64> {
    PerMotor::all(array, 1.0)
}

/// Checks drives of motors of an array.
pub(crate) fn check_drives(array: Array, drives: &[Drive]) -> Result<(), KeyError> {
    for (index, drive) in drives.iter().enumerate() {
        check_drive(array, drive).map_err(|fault| fault.within(&format!("drives[{index}]")))?;
    }
    let Some((first, second)) = pattern::overlap(drives) else { return Ok(()) };
    let later = &drives[second];
    let problem = Problem::Overlap { motor: later.motor, other: first, start_s: later.start() };
    Err(KeyError::key("motor", problem).within(&format!("drives[{second}]")))
}

fn check_afferents(afferents: &[Position]) -> Result<(), KeyError> {
    for (index, at) in afferents.iter().enumerate() {
        for (key, found) in [("x_mm", at.x_mm), ("y_mm", at.y_mm)] {
            in_range(key, found, found.abs() <= 1e6, "-1000000 to 1000000 mm")
                .map_err(|fault| fault.within(&format!("afferents[{index}]")))?;
        }
    }
    Ok(())
}

fn check_drive(array: Array, drive: &Drive) -> Result<(), KeyError> {
    in_range("motor", drive.motor.into(), array.has(drive.motor), array.motor_range())?;
    drive.wave(array).map_err(|source| {
        let key = match source {
            MotorError::Frequency { .. } => "frequency_hz",
            MotorError::Amplitude { .. } => "amplitude_um",
            MotorError::Phase { .. } => "phase",
        };
        KeyError::key(key, Problem::Wave(source))
    })?;
    for (key, time) in [("start_s", drive.start_s), ("stop_s", drive.stop_s)] {
        time.map_or(Ok(()), |found| seconds(key, found))?;
    }
    match drive.stop_s {
        Some(stop_s) if stop_s <= drive.start() => {
            Err(KeyError::key("stop_s", Problem::StopsBeforeStart { start_s: drive.start(), stop_s }))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::membrane::Rectify;

    const DRIVE: Drive =
        Drive { motor: 3, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.0, start_s: None, stop_s: None };

    fn scene(drives: Vec<Drive>, model: AfferentModel) -> Result<Scene, String> {
        let afferents = vec![Position { x_mm: 0.0, y_mm: -0.0 }];
        Scene::new(Array::paper(), 1.0, 7, drives, afferents, model).map_err(|error| error.to_string())
    }

    #[test]
    fn a_built_scene_is_checked_as_a_read_one() {
        let model = AfferentModel::default_for(Rectify::Half, 0.0);
        let line = scene(vec![Drive { motor: 24, ..DRIVE }], model).unwrap_err();
        assert_eq!(line, "`drives[0].motor` is 24: must be 0 to 23");
        let line = scene(vec![DRIVE, DRIVE], model).unwrap_err();
        assert!(line.starts_with("`drives[1].motor`: motor 3 is still driven by drives[0]"), "{line}");
        let line = scene(vec![], AfferentModel { tau_s: f64::NAN, ..model }).unwrap_err();
        assert_eq!(line, "`afferent.tau_s` is NaN: must be 1e-9 to 1e9 s");
        let line =
            Scene::new(Array::paper(), f64::INFINITY, 0, vec![], vec![], model).unwrap_err().to_string();
        assert_eq!(line, "`duration_s` is inf: must be 0 to 1000000000 s");
    }

    #[test]
    fn a_changed_part_is_checked_and_the_others_stay() {
        let scene = scene(vec![DRIVE], AfferentModel::default_for(Rectify::Half, 0.05)).unwrap();
        let mut gains = ideal(Array::paper());
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
            (at_rest.drives().len(), at_rest.afferents(), at_rest.gains()),
            (0, scene.afferents(), &gains)
        );
    }
}
