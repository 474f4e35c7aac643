//! Computes the effect of each motor on an afferent's dynamic stimulus, while all pins touch the skin.
//!
//! A motor that moves one pin changes the loads of all pins, and each load reaches the afferent with a weight and a delay
//! (`stimulus`). Without loss of contact the sum is linear: the stimulus is a weighted sum of the motors' own velocities, each
//! delayed by zero to some samples. [`Influence`] takes the first two terms of each delayed velocity, v(t - d) = v(t) - d·(v(t) -
//! v(t - 1)). Velocities are filtered to about 100 Hz, where the neglected terms are below 1 % for the pins that matter.
//!
//! Resting pins hold the skin in place, so a motor's influence fades within two or three pitches. An influence below a share of the
//! largest counts as 0.

use super::afferent::Afferent;
use super::contact::{Contact, FlatPins, Place};
use super::punch::Punch;
use super::stimulus::Field;
use super::{ELASTICITY, POISSON};
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;

/// A motor may move its pin further than ordered by this factor, because strokes are whole pulses.
const ROUNDING: f64 = 1.02;

/// An afferent's weights of each motor's velocity, N/mm⁴ per mm/s.
#[derive(Debug)]
pub(super) struct Influence {
    /// By motor: the weight of the velocity at a sample, and that of the velocity one sample before.
    pub(super) weights: Vec<[f32; 2]>,
    /// The motors whose influence counts, one bit each.
    pub(super) motors: u64,
}

impl Influence {
    /// The influence of motors with these gains. An influence below `min_share` of a pin's influence at its own place counts as 0.
    pub(super) fn new(
        afferent: &Afferent,
        pins: &FlatPins,
        contact: &Contact,
        gains: &PerMotor<f64>,
        min_share: f64,
    ) -> Self {
        let field = Field::new(afferent, pins);
        let depth_mm = afferent.class.depth_mm();
        let largest = ELASTICITY / ((1.0 - POISSON * POISSON) * depth_mm * depth_mm);
        let mut influence = Self { weights: vec![[0.0; 2]; gains.len()], motors: 0 };
        for (motor, gain) in gains.iter().enumerate() {
            let (mut sum, mut delayed) = (0.0, 0.0);
            for (pin, (weight, &delay)) in field.moving.iter().zip(&field.delays).enumerate() {
                let share = weight * contact.stiffness(pin, motor);
                sum += share;
                delayed += share * f64::from(delay);
            }
            if gain * sum.abs() >= min_share * largest {
                influence.weights[motor] = [(gain * (sum - delayed)) as f32, (gain * delayed) as f32];
                influence.motors |= 1 << motor;
            }
        }
        influence
    }
}

/// Whether all pins always touch the skin, for any drives of motors with these gains at this amplitude.
pub(super) fn all_touch(
    contact: &Contact,
    gains: &PerMotor<f64>,
    preindent_mm: f64,
    amplitude_um: f64,
) -> bool {
    let highest_mm = 1e-3 * amplitude_um * ROUNDING;
    (0..contact.pins()).all(|pin| {
        let rest: f64 = (0..contact.pins()).map(|of| preindent_mm * contact.stiffness(pin, of)).sum();
        // The worst case: every motor that relieves the pin is up, every other is down.
        let relief: f64 = (0..contact.pins())
            .map(|of| (gains[of] * highest_mm * contact.stiffness(pin, of)).min(0.0))
            .sum();
        rest + relief > 0.0
    })
}

/// How far the skin moves per distance that one pin of an array moves while the others stay, by place and then by motor. Places are
/// `[x, y]` in mm. All pins touch.
#[must_use]
#[expect(clippy::missing_panics_doc, reason = "it does not happen")]
pub fn pin_shapes(array: Array, places_mm: &[[f64; 2]]) -> Vec<Vec<f64>> {
    let places = array.positions_mm().iter().map(|&[x_mm, y_mm]| Place { x_mm, y_mm }).collect();
    let pins = FlatPins { places, punch: Punch { radius_mm: array.pin_radius_mm() } };
    let contact = Contact::new(&pins).expect("the pins of an array are told apart");
    let shape = |&[x_mm, y_mm]: &[f64; 2]| {
        let at = Place { x_mm, y_mm };
        let flexibility: Vec<f64> =
            pins.places.iter().map(|pin| pins.punch.flexibility(at.distance_mm(*pin))).collect();
        let of = |motor| {
            let terms = flexibility.iter().enumerate();
            terms.map(|(pin, flexibility)| flexibility * contact.stiffness(pin, motor)).sum()
        };
        (0..contact.pins()).map(of).collect()
    };
    places_mm.iter().map(shape).collect()
}
