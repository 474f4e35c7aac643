//! What may not be as a pattern was told: motors, the finger's place, its pressure.
//!
//! A [`Judge`](crate::Judge) compares the response with that to the object on the finger in its place.

use crate::judge::response_on;
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::random;
use meissner_skin::{Finger, FingerError};
use serde::Serialize;

/// How far motors are off at most, as a share of what they are told.
const MOTORS_OFF: f64 = 0.1;
/// How far the finger lies off, mm.
const FINGER_OFF_MM: f64 = 1.0;
/// Separate the gains of motors and the directions of fingers from other random numbers.
const MOTOR_WORD: u64 = 22;
const FINGER_WORD: u64 = MOTOR_WORD + 1;

/// What is not as it was told.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Change {
    /// Each motor goes 0.9 to 1.1 times as far as it is told, as uncalibrated ones do.
    MotorsOff,
    /// The finger lies 1 mm off, in a random direction.
    FingerOff,
    /// Pins press into the skin by 0.3 mm, in place of 0.5.
    Light,
    /// They press by 1 mm.
    Firm,
}

impl Change {
    /// All.
    pub const ALL: [Self; 4] = [Self::MotorsOff, Self::FingerOff, Self::Light, Self::Firm];

    /// A finger under the pins.
    fn finger(self, seed: u64, finger: u64) -> Finger {
        let pressed = |preindent_mm| Finger::new(finger).pressed(preindent_mm);
        match self {
            Self::MotorsOff => Finger::new(finger),
            Self::FingerOff => {
                let [turns, _] = random::uniform([seed, finger, 0, FINGER_WORD]);
                let angle = std::f64::consts::TAU * turns;
                let by_mm = [libm::cos(angle), libm::sin(angle)].map(|share| FINGER_OFF_MM * share);
                Finger::new(finger).shifted(by_mm)
            }
            Self::Light => pressed(0.3),
            Self::Firm => pressed(1.0),
        }
    }

    /// The finger of a seed under the object, if the change concerns the object. `seed` is that of what is random.
    #[must_use]
    pub fn of_object(self, seed: u64, finger: u64) -> Option<Finger> {
        (self == Self::FingerOff).then(|| self.finger(seed, finger))
    }

    /// The response of the finger of a seed to a pattern, s, by afferent. `seed` is that of what is random.
    ///
    /// # Errors
    /// If the pattern cannot be compiled or simulated.
    pub fn response(
        self,
        seed: u64,
        finger: u64,
        pattern: &Pattern,
        seconds: f64,
        noise_seed: u64,
    ) -> Result<Vec<Vec<f64>>, FingerError> {
        let gains = PerMotor::from_fn(pattern.array(), |motor| {
            let [share, _] = random::uniform([seed, finger, motor.into(), MOTOR_WORD]);
            if self == Self::MotorsOff { 1.0 + MOTORS_OFF * (2.0 * share - 1.0) } else { 1.0 }
        });
        response_on(&self.finger(seed, finger), pattern, &gains, seconds, noise_seed)
    }
}
