//! How the skin moves with one pin of an array, while all pins touch it.

use super::contact::{Contact, FlatPins};
use super::punch::Punch;
use crate::membrane::Position;
use meissner_array::spec::Array;

/// How far the skin moves per distance that one pin of an array moves while the others stay, by place and then by motor. Places are
/// `[x, y]` in mm. All pins touch.
pub fn pin_shapes(array: Array, places_mm: &[[f64; 2]]) -> Vec<Vec<f64>> {
    let places = array.positions_mm().iter().map(|&[x_mm, y_mm]| Position { x_mm, y_mm }).collect();
    let pins = FlatPins { places, punch: Punch { radius_mm: array.pin_radius_mm() } };
    let contact = Contact::new(&pins).expect("the pins of an array are told apart");
    let shape = |&[x_mm, y_mm]: &[f64; 2]| {
        let at = Position { x_mm, y_mm };
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
