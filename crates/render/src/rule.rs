//! The plain answer: one press of the full travel, graded by the distance of each pin from the object.

use crate::levels::{Levels, Limits, STEP_S};
use meissner_array::spec::Array;
use meissner_touch::{Contact, Pose, Touch};

/// How far a press reaches beyond the object, mm (SD of a Gaussian).
const REACH_MM: f64 = 1.0;

/// Pins press while the object does.
pub(crate) fn press(array: Array, contact: &Contact, touch: &Touch, moments: usize) -> Levels {
    let limits = Limits::of(array);
    let mut levels = Levels::at_rest(moments, array.motors());
    let mut before = None;
    let mut pressed = vec![0.0; array.motors()];
    for (moment, heights) in levels.heights_mm.iter_mut().enumerate() {
        let t_s = moment as f64 * STEP_S;
        if t_s > touch.duration_s() {
            break;
        }
        let pose = touch.pose(t_s);
        if before != Some(pose) {
            let height = |pin: &[f64; 2]| {
                let beyond_mm = beyond_mm(contact, &pose, *pin);
                limits.highest_mm * libm::exp(-beyond_mm * beyond_mm / (2.0 * REACH_MM * REACH_MM))
            };
            pressed = array.positions_mm().iter().map(height).collect();
            before = Some(pose);
        }
        heights.clone_from(&pressed);
    }
    levels.limit(limits);
    levels
}

/// How far a place on the skin is from the part of the object that touches it, mm; infinite if none does.
pub(crate) fn beyond_mm(contact: &Contact, pose: &Pose, at: [f64; 2]) -> f64 {
    let squared = |[x, y]: [f64; 2]| (x - at[0]) * (x - at[0]) + (y - at[1]) * (y - at[1]);
    let nearest = touching(contact, pose).map(squared).fold(f64::INFINITY, f64::min);
    (nearest.sqrt() - contact.grains().pitch_mm / 2.0).max(0.0)
}

/// The places on the skin of the grains that touch it.
pub(crate) fn touching(contact: &Contact, pose: &Pose) -> impl Iterator<Item = [f64; 2]> {
    let (turn, depth_mm) = (pose.angle_deg.to_radians(), pose.depth_mm);
    let (sin, cos, x_mm, y_mm) = (libm::sin(turn), libm::cos(turn), pose.x_mm, pose.y_mm);
    let grains = contact.grains();
    let touching = grains.places_mm.iter().zip(&grains.heights_mm);
    touching
        .filter(move |(_, height_mm)| **height_mm + depth_mm > 0.0)
        .map(move |([x, y], _)| [x_mm + x * cos - y * sin, y_mm + x * sin + y * cos])
}
