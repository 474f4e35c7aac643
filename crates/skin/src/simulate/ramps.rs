//! What motors really did, burst by burst, and what receptors made of it.
//!
//! A drive says what a motor is to do. What it did is a list of [`Ramp`]s: each burst with the travel it really had. A
//! motor's fastest ramp is taken for its gain, and so goes into the receptors' weights; the others are shares of it.
//! So all that is exact of drives stays so, and ramps of one gain are drives on a motor of that gain.
//!
//! A pin that meets its end stop within a burst moves fast and then not at all. Who knows no more than the burst's travel
//! tells it as a slower ramp. With stops at ±500 µm, at which a pin that nobody corrects loses little of a burst, that
//! moves a pattern's contrast by less than 0.5 impulses/s; if stops take half of every burst, it comes out an eighth too low
//! (`tests/felt.rs`). Who knows when the pin stopped tells a shorter ramp.
//!
//! Invariant: a motor's ramps are in order of time and do not overlap.

use super::breaks::in_parts;
use super::engine::{by_place, run};
use super::scene::MOST_GAIN;
use super::track::{Track, Tracks};
use super::{Method, MethodError, Options, Scene, in_seconds};
use firmware_protocol::stroke::MOTORS;
use firmware_protocol::tick::Tick;
use meissner_array::motor::Ramp;
use meissner_array::units::UM_PER_PULSE;
use std::sync::Arc;

/// Receptors whose spikes are in memory at a time: of a minute at 1 000 impulses/s, 46 MB; at 200, 9 MB.
const AT_A_TIME: usize = 32;

/// What each motor did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ramps {
    motors: [Arc<Vec<Ramp>>; MOTORS],
}

/// Ramps that no motor made.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RampsError {
    /// No such motor.
    #[error("a burst of motor {motor}: must be 0 to 23")]
    Motor {
        /// As given.
        motor: u8,
    },
    /// Before the end of the one before.
    #[error("a burst of motor {motor} at tick {}: must not begin before the last one has ended", .start.0)]
    Order {
        /// Whose.
        motor: u8,
        /// When it begins.
        start: Tick,
    },
    /// Beyond what a gain may be.
    #[error(
        "a burst of motor {motor} at tick {} moves {um_per_tick} um per pulse: must be at most {MOST_GAIN} times \
         {UM_PER_PULSE:.4}, either way",
        .start.0
    )]
    Travel {
        /// Whose.
        motor: u8,
        /// When it begins.
        start: Tick,
        /// As given.
        um_per_tick: f64,
    },
}

impl Ramps {
    /// Ramps with their motors, each motor's in order of time; ticks count from the scene's beginning. A ramp may go
    /// either way, whatever the direction of its pulses. Each takes 24 bytes.
    ///
    /// # Errors
    /// The first one that no motor can have made.
    pub fn new(ramps: impl IntoIterator<Item = (u8, Ramp)>) -> Result<Self, RampsError> {
        let mut motors: [Vec<Ramp>; MOTORS] = Default::default();
        for (motor, ramp) in ramps {
            let Ramp { start, um_per_tick, .. } = ramp;
            let of_motor = motors.get_mut(usize::from(motor)).ok_or(RampsError::Motor { motor })?;
            let free = of_motor.last().map_or(0, |last| last.start.0.saturating_add(last.ticks.into()));
            if start.0 < free {
                return Err(RampsError::Order { motor, start });
            }
            if !(0.0..=MOST_GAIN).contains(&gain(um_per_tick)) {
                return Err(RampsError::Travel { motor, start, um_per_tick });
            }
            if ramp.ticks > 0 {
                of_motor.push(ramp);
            }
        }
        Ok(Self { motors: motors.map(Arc::new) })
    }

    /// Of each motor the gain of its fastest ramp.
    pub(super) fn gains(&self) -> [f64; MOTORS] {
        std::array::from_fn(|motor| {
            self.motors[motor].iter().map(|ramp| gain(ramp.um_per_tick)).fold(0.0, f64::max)
        })
    }

    pub(super) fn tracks(&self, gains: &[f64; MOTORS], duration_s: f64) -> Tracks {
        std::array::from_fn(|motor| {
            let full_um_per_tick = UM_PER_PULSE * gains[motor];
            let track = || Track::of_ramps(motor as u8, &self.motors[motor], full_um_per_tick, duration_s);
            (full_um_per_tick > 0.0).then(|| Arc::new(track()))
        })
    }
}

/// How much faster than the model's a ramp is, either way, in whole parts: a travel that was divided by its pulses is rounded,
/// and the model's own should be 1.
fn gain(um_per_tick: f64) -> f64 {
    in_parts(um_per_tick.abs() / UM_PER_PULSE)
}

/// Simulates a scene exactly, but moved by `ramps`: its drives and gains are not looked at. `give` is handed each receptor's
/// number and spikes, s, in no particular order.
///
/// Besides the ramps it takes 16 MB for breaks, and for spikes what 32 receptors fire.
///
/// # Errors
/// If there are more spikes than are kept.
pub fn simulate_ramps(
    scene: &Scene,
    ramps: &Ramps,
    mut give: impl FnMut(u32, Vec<f64>),
) -> Result<(), MethodError> {
    let gains = ramps.gains();
    let (scene, tracks) = (scene.moved_otherwise(gains), ramps.tracks(&gains, scene.duration_s()));
    let all: Vec<u32> = (0..scene.receptors().len() as u32).collect();
    for some in by_place(&scene, &all).chunks(AT_A_TIME) {
        run(&scene, &tracks, some, &Options::spikes(Method::Exact), &|_| (), |(number, _, half_ticks)| {
            give(number, in_seconds(half_ticks));
        })?;
    }
    Ok(())
}
