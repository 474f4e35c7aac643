//! Simulates the spikes that follow from measured bursts of motors.
//!
//! A drive is the order to a motor. [`Ramps`] are what the motor did: each burst with its measured travel. [`simulate_ramps`] takes
//! the speed of a motor's fastest ramp as the motor's gain, which goes into the weights, and the other ramps as shares of it. So
//! everything that is exact for drives stays exact, and ramps of one gain give the same answer as drives on a motor of that gain.
//!
//! A pin that meets its end stop within a burst moves fast and then not at all. A caller that knows only the burst's travel
//! describes it as a slower ramp. With stops at ±500 µm, an uncorrected pin loses little of a burst, and this moves a pattern's
//! contrast by less than 0.5 impulses/s. If stops cut half of every burst, the computed contrast is an eighth too low (measured at
//! commit e7f11c0d). A caller that knows when the pin stopped describes a shorter ramp.
//!
//! Invariant: a motor's ramps are in order of time and do not overlap.

use crate::breakpoints::Parts;
use crate::engine::{Train, run};
use crate::member::by_place;
use crate::method::{Method, MethodError, Options};
use crate::scene::{MAX_GAIN, Scene};
use crate::time::in_seconds;
use crate::track::{Track, Tracks};
use firmware_protocol::tick::Tick;
use meissner_array::motor::Ramp;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::strokes::{Strokes, StrokesError};
use pulp::Arch;
use std::sync::Arc;

/// The most ramps of strokes and moves that are taken at once: 200 MB, ten minutes of 12 000 moves a second.
pub const MAX_RAMPS: usize = 8 << 20;

/// Afferents whose spikes are in memory twice. A minute at 1 000 impulses/s takes 46 MB; at 200, 9 MB.
const AT_A_TIME: usize = 32;

/// The ramps of each motor of an array.
#[derive(Clone, Debug, PartialEq)]
pub struct Ramps {
    array: Array,
    motors: Vec<Arc<Vec<Ramp>>>,
}

/// Why no motor can have made some ramps.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RampsError {
    /// There is no such motor.
    #[error("a burst of motor {motor}: must be {}", .array.motor_range())]
    Motor {
        /// The number given.
        motor: u8,
        /// The array.
        array: Array,
    },
    /// A ramp begins before the one before has ended.
    #[error("a burst of motor {motor} at tick {}: must not begin before the last one has ended", .start.0)]
    Order {
        /// Its motor.
        motor: u8,
        /// Its start.
        start: Tick,
    },
    /// A ramp is faster than the largest gain allows.
    #[error(
        "a burst of motor {motor} at tick {} moves {um_per_tick} um per pulse: must be at most {MAX_GAIN} times \
         {um_per_pulse:.4}, either way",
        .start.0
    )]
    Travel {
        /// Its motor.
        motor: u8,
        /// Its start.
        start: Tick,
        /// Its speed.
        um_per_tick: f64,
        /// The travel of the model's motors.
        um_per_pulse: f64,
    },
    /// The strokes cannot be compiled to their end.
    #[error(transparent)]
    Strokes(#[from] StrokesError),
    /// A long play of many motors.
    #[error("more than {MAX_RAMPS} bursts to simulate: take a shorter time")]
    TooMany,
}

impl Ramps {
    /// Takes ramps with their motors of an array, each motor's in order of time. Ticks count from the beginning of the scene. A ramp
    /// may go up or down, even against the direction of its pulses. Each takes 24 bytes.
    ///
    /// # Errors
    /// The first ramp that no motor can have made.
    pub fn new(array: Array, ramps: impl IntoIterator<Item = (u8, Ramp)>) -> Result<Self, RampsError> {
        let gain = gain(array);
        let mut motors: Vec<Vec<Ramp>> = vec![Vec::new(); array.motors()];
        for (motor, ramp) in ramps {
            let Ramp { start, um_per_tick, .. } = ramp;
            let of_motor = motors.get_mut(usize::from(motor)).ok_or(RampsError::Motor { motor, array })?;
            let free = of_motor.last().map_or(0, |last| last.start.0.saturating_add(last.ticks.into()));
            if start.0 < free {
                return Err(RampsError::Order { motor, start });
            }
            if !(0.0..=MAX_GAIN).contains(&gain(um_per_tick)) {
                let um_per_pulse = array.motor().um_per_pulse;
                return Err(RampsError::Travel { motor, start, um_per_tick, um_per_pulse });
            }
            if ramp.ticks > 0 {
                of_motor.push(ramp);
            }
        }
        Ok(Self { array, motors: motors.into_iter().map(Arc::new).collect() })
    }

    /// What ideal motors do with strokes and moves that begin in their first `duration_s`. A lower stop absorbs a surplus.
    ///
    /// # Errors
    /// If they cannot be compiled, or are more than [`MAX_RAMPS`].
    pub fn of_strokes(strokes: Strokes, duration_s: f64) -> Result<Self, RampsError> {
        let array = strokes.array();
        let (end, um_per_pulse) = (array.rate().seconds_to_ticks(duration_s), array.motor().um_per_pulse);
        let mut ramps = Vec::new();
        for step in strokes {
            let step = step?;
            if step.begin().0 >= end {
                break;
            }
            ramps.extend(step.ramps(um_per_pulse).map(|ramp| (step.motor(), ramp)));
            if ramps.len() > MAX_RAMPS {
                return Err(RampsError::TooMany);
            }
        }
        Self::new(array, ramps)
    }

    /// The ramps of motors that go so many times as far as they were told.
    ///
    /// # Errors
    /// If a ramp is then faster than any motor.
    pub fn scaled(&self, gains: &PerMotor<f64>) -> Result<Self, RampsError> {
        let of_motor = |((motor, ramps), gain): ((u8, &Arc<Vec<Ramp>>), &f64)| -> Vec<(u8, Ramp)> {
            let scaled = |ramp: &Ramp| Ramp { um_per_tick: gain * ramp.um_per_tick, ..*ramp };
            ramps.iter().map(|ramp| (motor, scaled(ramp))).collect()
        };
        Self::new(self.array, self.array.numbers().zip(&self.motors).zip(gains).flat_map(of_motor))
    }

    /// The array of the motors.
    pub const fn array(&self) -> Array {
        self.array
    }

    /// The gain of each motor's fastest ramp.
    pub(crate) fn gains(&self) -> PerMotor<f64> {
        let gain = gain(self.array);
        PerMotor::from_fn(self.array, |motor| {
            self.motors[usize::from(motor)].iter().map(|ramp| gain(ramp.um_per_tick)).fold(0.0, f64::max)
        })
    }

    pub(crate) fn tracks(&self, gains: &PerMotor<f64>, duration_s: f64) -> Tracks {
        let track = |((motor, ramps), gain): ((u8, &Arc<Vec<Ramp>>), &f64)| {
            let full_um_per_tick = self.array.motor().um_per_pulse * gain;
            let track = || Track::of_ramps(self.array, motor, ramps, full_um_per_tick, duration_s);
            (full_um_per_tick > 0.0).then(|| Arc::new(track()))
        };
        self.array.numbers().zip(&self.motors).zip(gains).map(track).collect()
    }
}

/// The absolute speed of a ramp over the model's, rounded to whole parts: a travel divided by its pulses has rounding errors, and
/// the model's own speed must give 1.
fn gain(array: Array) -> impl Fn(f64) -> f64 {
    let (parts, um_per_pulse) = (Parts::of(array.motor()), array.motor().um_per_pulse);
    move |um_per_tick| parts.round(um_per_tick.abs() / um_per_pulse)
}

/// Simulates a scene by the finest method, moved by `ramps`; its drives and gains are ignored. The answer is each afferent's spikes, s.
///
/// # Errors
/// If there are more than [`MAX_SPIKES`](crate::MAX_SPIKES) spikes to keep.
///
/// # Panics
/// If scene and ramps are for different arrays.
pub fn simulate_ramps(scene: &Scene, ramps: &Ramps) -> Result<Vec<Vec<f64>>, MethodError> {
    assert_eq!(scene.array(), ramps.array(), "the ramps are those of the scene's motors");
    let gains = ramps.gains();
    let (scene, tracks) = (scene.without_drives(gains), ramps.tracks(&gains, scene.duration_s()));
    let all: Vec<u32> = (0..scene.afferents().len() as u32).collect();
    let mut spikes_s = vec![Vec::new(); all.len()];
    let mut give = |(number, _, half_ticks): Train| {
        spikes_s[number as usize] = in_seconds(half_ticks, scene.array().rate());
    };
    for some in by_place(&scene, &all).chunks(AT_A_TIME) {
        run(Arch::new(), &scene, &tracks, some, &Options::spikes(Method::Exact), &|_| (), &mut give)?;
    }
    Ok(spikes_s)
}
