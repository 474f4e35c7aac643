//! Moves a single pin under afferents of either model: as a sine, or by one press.
//!
//! The second model takes the pin's motion as a formula. The first model takes motor ramps, so the sine is made of short ramps of a
//! motor of the paper's array. A motor smooths its ramps over a window; to compensate, the ramps are stronger by the factor by which
//! that weakens a sine of this frequency.
//!
//! Invariant: both models get the same motion of the pin.

use crate::afferents::{Class, simulate};
use crate::membrane::{AfferentModel, Position, Rectify};
use crate::{AnyScene, Keep, ModelName, Ramps, Scene, simulate_ramps};
use firmware_protocol::tick::Tick;
use meissner_array::motor::Ramp;
use meissner_array::spec::Array;
use serde_json::json;
use std::f64::consts::{PI, TAU};

/// Vibration before spikes are counted, s.
const SETTLING_S: f64 = 0.2;
/// Vibration while spikes are counted, s: at least four cycles of 5 Hz.
pub(super) const COUNTED_S: f64 = 0.8;
/// When the vibration of the second model's pin begins, s: by then the pin is pressed in and SA1 afferents have adapted.
const BEGIN_S: f64 = 0.4;
/// How long a pressed-in pin stays, s.
const HELD_S: f64 = 0.2;
/// Gain of the fastest ramps.
const MOST_GAIN: f64 = 10.0;
/// Ramps in a cycle, at least, where ticks allow.
const RAMPS: f64 = 64.0;
/// The motor of the paper's array whose pin moves.
const MOTOR: u8 = 9;

/// The speed at which a pin is pressed in, mm/s: that of the motors of the paper's array.
fn press_mm_s() -> f64 {
    let array = Array::paper();
    array.motor().um_per_pulse * f64::from(array.rate().hz()) / 1000.0
}

/// An afferent at a distance from the pin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub(super) class: Class,
    pub(super) row: usize,
    pub(super) away_mm: f64,
}

/// Spikes of each afferent while a pin vibrates, after it has settled, in [`COUNTED_S`]. The amplitude is peak to peak.
pub(super) fn sine(
    model: ModelName,
    frequency_hz: f64,
    amplitude_um: f64,
    afferents: &[Placed],
) -> Vec<usize> {
    let (spikes_s, from_s) = match model {
        ModelName::Membrane => {
            (membrane(sine_ramps(frequency_hz, amplitude_um), SETTLING_S + COUNTED_S, afferents), 0.0)
        }
        ModelName::Afferents => {
            let scene = json!({
                "duration_s": BEGIN_S + SETTLING_S + COUNTED_S, "begin_s": BEGIN_S, "ramp_s": 0.1, "preindent_mm": 0.5,
                "pins": [{"x_mm": 0.0, "y_mm": 0.0, "frequency_hz": frequency_hz, "amplitude_um": amplitude_um}],
            });
            (fingertip(scene, afferents), BEGIN_S)
        }
    };
    let counted = |train: &Vec<f64>| train.iter().filter(|&&at_s| at_s >= from_s + SETTLING_S).count();
    spikes_s.iter().map(counted).collect()
}

/// Spikes of each afferent while a pin is pressed in by `depth_um`, and for [`HELD_S`] after.
pub(super) fn press(model: ModelName, depth_um: f64, afferents: &[Placed]) -> Vec<usize> {
    let ramp_s = depth_um / 1000.0 / press_mm_s();
    let spikes_s = match model {
        ModelName::Membrane => {
            let um_per_tick = Array::paper().motor().um_per_pulse;
            let ticks = (depth_um / um_per_tick).round() as u32;
            membrane(vec![Ramp { start: Tick(0), ticks, um_per_tick }], ramp_s + HELD_S, afferents)
        }
        ModelName::Afferents => {
            let still = json!([{"x_mm": 0.0, "y_mm": 0.0, "frequency_hz": 0.0, "amplitude_um": 0.0}]);
            let scene = json!({
                "duration_s": ramp_s + HELD_S, "begin_s": 0.0, "ramp_s": ramp_s, "preindent_mm": depth_um / 1000.0, "pins": still,
            });
            fingertip(scene, afferents)
        }
    };
    spikes_s.iter().map(Vec::len).collect()
}

/// Spikes of a scene of the second model without noise, s.
fn fingertip(mut scene: serde_json::Value, afferents: &[Placed]) -> Vec<Vec<f64>> {
    let afferent = |of: &Placed| json!({"class": of.class, "row": of.row, "x_mm": of.away_mm, "y_mm": 0.0});
    scene["afferents"] = afferents.iter().map(afferent).collect();
    scene["noise"] = false.into();
    spikes_s(&scene)
}

/// Spikes of a scene of the second model, s.
pub(super) fn spikes_s(scene: &serde_json::Value) -> Vec<Vec<f64>> {
    let read = AnyScene::read(&scene.to_string(), "validate", Some(ModelName::Afferents));
    let Ok(AnyScene::Afferents(scene)) = read else { panic!("a scene of validate cannot be read: {read:?}") };
    let answer = simulate(&scene, Keep::Spikes, &|_| ()).expect("scenes of validate are short");
    answer.spikes_s.expect("spikes are kept")
}

/// Spikes of the first model without noise while a motor makes ramps, s.
fn membrane(ramps: Vec<Ramp>, duration_s: f64, afferents: &[Placed]) -> Vec<Vec<f64>> {
    let array = Array::paper();
    let [x_mm, y_mm] = array.position_mm(MOTOR);
    let places = afferents.iter().map(|of| Position { x_mm: x_mm + of.away_mm, y_mm }).collect();
    let model = AfferentModel::default_for(Rectify::default(), 0.0);
    let scene =
        Scene::new(array, duration_s, 0, Vec::new(), places, model).expect("a scene of validate is valid");
    let ramps = Ramps::new(array, ramps.into_iter().map(|ramp| (MOTOR, ramp)))
        .expect("amplitudes of validate are within the gains");
    simulate_ramps(&scene, &ramps).expect("scenes of validate are short")
}

/// Whether a probe can make this vibration: ramps are at most ten times as fast as a motor's.
pub(super) fn can_give(model: ModelName, frequency_hz: f64, amplitude_um: f64) -> bool {
    let fastest_mm_s = PI * frequency_hz * stronger_um(frequency_hz, amplitude_um) / 1000.0;
    model == ModelName::Afferents || fastest_mm_s <= MOST_GAIN * press_mm_s()
}

/// The amplitude of the ramps whose smoothed motion has amplitude `amplitude_um`, µm.
fn stronger_um(frequency_hz: f64, amplitude_um: f64) -> f64 {
    let array = Array::paper();
    let window_s = array.motor().window_ticks() / f64::from(array.rate().hz());
    let angle = PI * frequency_hz * window_s;
    amplitude_um * angle / angle.sin().abs()
}

/// The ramps that move a pin as a sine for the whole time, from its lowest point on.
fn sine_ramps(frequency_hz: f64, amplitude_um: f64) -> Vec<Ramp> {
    let stronger_um = stronger_um(frequency_hz, amplitude_um);
    let tick_hz = f64::from(Array::paper().rate().hz());
    let ticks = (tick_hz / frequency_hz / RAMPS).floor().max(1.0);
    let place_um = |tick: f64| stronger_um / 2.0 * (1.0 - (TAU * frequency_hz * tick / tick_hz).cos());
    let count = ((SETTLING_S + COUNTED_S) * tick_hz / ticks) as u64;
    let ramp = |number: u64| {
        let start = number as f64 * ticks;
        let um_per_tick = (place_um(start + ticks) - place_um(start)) / ticks;
        Ramp { start: Tick(start as u64), ticks: ticks as u32, um_per_tick }
    };
    (0..count).map(ramp).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::motor::{HalfTick, Shaft};

    #[test]
    fn ramps_move_a_motor_as_a_sine_of_the_amplitude() {
        for (hz, um) in [(5.0, 200.0), (60.0, 80.0), (200.0, 10.0)] {
            let ramps = sine_ramps(hz, um);
            let mut shaft = Shaft::new(Array::paper().motor());
            let mut places = Vec::new();
            for pair in ramps.windows(2) {
                shaft.push(pair[0]);
                if pair[1].start.0 > 42_500 {
                    places.push(shaft.displacement_um(HalfTick::from(pair[1].start)));
                }
            }
            let [low, high] = [f64::min, f64::max].map(|of| places.iter().copied().reduce(of).unwrap());
            assert!((high - low - um).abs() < 0.01 * um, "{hz} Hz: {} of {um}", high - low);
        }
    }
}
