//! One drive of a pattern: a square wave on one motor, with its start and stop.
//!
//! Invariant: [`Drive::check`] accepts only values within the ranges of `limits` and within the pattern's duration.

use super::error::{KeyError, Problem};
use super::limits::{FREQUENCY_HZ, MAX_SECONDS};
use crate::motor::{MotorError, SquareWave};
use crate::spec::{Array, motor_number};
use meissner_input::document::in_range;
use serde::{Deserialize, Serialize};

/// A square wave on one motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// One of the array.
    #[serde(deserialize_with = "motor_number")]
    pub motor: u8,
    /// Within [`FREQUENCY_HZ`].
    pub frequency_hz: f64,
    /// Peak to peak, up to the travel of the array's motors; 0: the motor is off.
    pub amplitude_um: f64,
    /// Cycles by which the first upward edge comes after the start, in [0, 1).
    #[serde(default)]
    pub phase: f64,
    /// When the drive begins, in pattern time; without it the drive begins with the pattern.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_s: Option<f64>,
    /// When its last stroke must have ended, in pattern time; without it the drive ends with the pattern.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stop_s: Option<f64>,
}

impl Drive {
    /// The drive's wave, counted from its start.
    ///
    /// # Errors
    /// If a number is out of the motor's range, which in a checked pattern none is.
    pub fn wave(&self, array: Array) -> Result<SquareWave, MotorError> {
        SquareWave::new(array, self.frequency_hz, self.amplitude_um, self.phase)
    }

    /// When the drive begins, s of pattern time.
    pub fn start(&self) -> f64 {
        self.start_s.unwrap_or(0.0)
    }

    pub(super) fn check(&self, array: Array, duration_s: Option<f64>) -> Result<(), KeyError> {
        in_range("motor", self.motor.into(), array.has(self.motor), array.motor_range())?;
        let hz = self.frequency_hz;
        in_range("frequency_hz", hz, FREQUENCY_HZ.contains(&hz), "0.1 to 300 Hz")?;
        let um = self.amplitude_um;
        let most_um = array.motor().travel_um;
        in_range("amplitude_um", um, (0.0..=most_um).contains(&um), format!("0 to {most_um} um"))?;
        in_range("phase", self.phase, (0.0..1.0).contains(&self.phase), "at least 0 and below 1")?;
        for (key, time) in [("start_s", self.start_s), ("stop_s", self.stop_s)] {
            let Some(found) = time else { continue };
            in_range(key, found, (0.0..=MAX_SECONDS).contains(&found), "0 to 100000000 s")?;
            // A drive may end with the pattern but not begin there.
            if let Some(duration_s) = duration_s
                && (found > duration_s || (key == "start_s" && found >= duration_s))
            {
                return Err(KeyError::key(key, Problem::BeyondDuration { found, duration_s }));
            }
        }
        match self.stop_s {
            Some(stop_s) if stop_s <= self.start() => {
                Err(KeyError::key("stop_s", Problem::StopsBeforeStart { start_s: self.start(), stop_s }))
            }
            _ => Ok(()),
        }
    }
}

/// The indices of two drives of one motor that overlap: the second begins before the first has stopped. Drives of
/// a motor may follow each other.
pub fn overlap(drives: &[Drive]) -> Option<(usize, usize)> {
    let mut order: Vec<usize> = (0..drives.len()).collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (&drives[a], &drives[b]);
        a.motor.cmp(&b.motor).then(a.start().total_cmp(&b.start()))
    });
    let overlapping = |pair: &&[usize]| {
        let (first, second) = (&drives[pair[0]], &drives[pair[1]]);
        first.motor == second.motor && first.stop_s.is_none_or(|stop| stop > second.start())
    };
    order.windows(2).find(overlapping).map(|pair| (pair[0], pair[1]))
}
