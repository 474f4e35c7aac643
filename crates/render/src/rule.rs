//! The plain answers: pins that press as far as they are near the object, at full speed.
//!
//! [`press`] holds them up: for an object that stays in place from the touch until the depth falls, for one that moves it follows. [`stroke`]
//! makes one stroke of each pin as the object passes it.

use crate::levels::{Levels, Limits, STEP_S};
use meissner_array::spec::Array;
use meissner_touch::{Contact, Pose, Touch};

/// How far a press reaches beyond the object, mm (SD of a Gaussian).
const REACH_MM: f64 = 1.3;
/// An object that is less near does not pass.
const LEAST: f64 = 0.05;

/// Pins press while the object does.
pub(crate) fn press(array: Array, contact: &Contact, touch: &Touch, near: &[Vec<f64>]) -> Levels {
    let limits = Limits::of(array);
    let mut levels = Levels::at_rest(near.len(), array.motors());
    if touch.stays_in_place() {
        let deepest = Pose { depth_mm: touch.most_depth_mm(), ..touch.pose(0.0) };
        let tops = near_at(array, contact, &deepest);
        let depth_mm = |moment: usize| match moment as f64 * STEP_S {
            t_s if t_s <= touch.duration_s() => touch.pose(t_s).depth_mm,
            _ => 0.0,
        };
        for moment in 1..near.len() {
            let (before_mm, now_mm) = (depth_mm(moment - 1), depth_mm(moment));
            let is_up = now_mm > 0.0 && (now_mm >= before_mm || now_mm > 0.99 * touch.most_depth_mm());
            for (motor, top) in tops.iter().enumerate() {
                let from_mm = levels.heights_mm[moment - 1][motor];
                let to_mm = if is_up { limits.highest_mm * top } else { 0.0 };
                let way_mm = (to_mm - from_mm).clamp(-limits.step_mm, limits.step_mm);
                levels.heights_mm[moment][motor] = from_mm + way_mm;
            }
        }
    } else {
        for (heights, near) in levels.heights_mm.iter_mut().zip(near) {
            heights.iter_mut().zip(near).for_each(|(height, near)| *height = limits.highest_mm * near);
        }
    }
    levels.limit(limits);
    levels
}

/// Each pin makes a stroke whenever the object passes. An object that stays in place is pressed.
pub(crate) fn stroke(array: Array, contact: &Contact, touch: &Touch, near: &[Vec<f64>]) -> Levels {
    if touch.stays_in_place() {
        return press(array, contact, touch, near);
    }
    let limits = Limits::of(array);
    let mut levels = Levels::at_rest(near.len(), array.motors());
    for motor in 0..array.motors() {
        for (middle, top) in passes(near.iter().map(|near| near[motor])) {
            for (moment, heights) in levels.heights_mm.iter_mut().enumerate() {
                let tent_mm = limits.highest_mm * top - limits.step_mm * (moment as f64 - middle).abs();
                heights[motor] = heights[motor].max(tent_mm);
            }
        }
    }
    levels.limit(limits);
    levels
}

/// The middle of each pass and how near the object comes. A pass ends where it is less than half as near, and the next begins where it is twice as
/// near as since: grains under a pin are no passes.
fn passes(near: impl Iterator<Item = f64>) -> Vec<(f64, f64)> {
    let (mut found, mut low) = (Vec::new(), 0.0_f64);
    let mut top: Option<(f64, usize, usize)> = None;
    for (moment, near) in near.chain([0.0]).enumerate() {
        match &mut top {
            None if near > LEAST && near > 2.0 * low => top = Some((near, moment, moment)),
            None => low = low.min(near),
            Some((most, ..)) if near < *most / 2.0 => {
                found.extend(top.take().map(|(most, first, last)| ((first + last) as f64 / 2.0, most)));
                low = near;
            }
            Some((most, first, last)) => {
                if near > 1.02 * *most {
                    *first = moment;
                }
                if near > 0.98 * *most {
                    *last = moment;
                }
                *most = most.max(near);
            }
        }
    }
    found
}

/// How near the object is to each pin, at each moment of the touch: 1 if it touches it, 0 far away and after the touch.
pub(crate) fn nearness(array: Array, contact: &Contact, touch: &Touch, moments: usize) -> Vec<Vec<f64>> {
    let mut before: Option<(Pose, Vec<f64>)> = None;
    let at = |moment: usize| {
        let t_s = moment as f64 * STEP_S;
        if t_s > touch.duration_s() {
            return vec![0.0; array.motors()];
        }
        let pose = touch.pose(t_s);
        if before.as_ref().is_none_or(|(same, _)| *same != pose) {
            before = Some((pose, near_at(array, contact, &pose)));
        }
        before.iter().flat_map(|(_, near)| near.clone()).collect()
    };
    (0..moments).map(at).collect()
}

fn near_at(array: Array, contact: &Contact, pose: &Pose) -> Vec<f64> {
    let near = |pin: &[f64; 2]| {
        let beyond_mm = beyond_mm(contact, pose, *pin);
        libm::exp(-beyond_mm * beyond_mm / (2.0 * REACH_MM * REACH_MM))
    };
    array.positions_mm().iter().map(near).collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_touch::{Object, Press, Scan, Shape, surface_of};

    fn contact(shape: &Shape, touch: &Touch) -> Contact {
        let object = Object::new("thing", surface_of(shape), touch.clone());
        Contact::new(object.grains(object.pitch_mm()), 0.5).unwrap()
    }

    /// A bar that slides along itself, a plate and two dots pass over the pins.
    #[test]
    fn a_pin_makes_a_stroke_for_each_pass_and_none_for_each_grain() {
        let bar = Shape::Polyline(vec![[-6.0, 0.0], [6.0, 0.0]]);
        let plate = Shape::Disc { center_mm: [0.0; 2], radius_mm: 4.0 };
        let dots = Shape::Dots(vec![[-5.0, 0.0], [5.0, 0.0]]);
        for (shape, strokes) in [(bar, 1), (plate, 1), (dots, 2)] {
            let scan =
                Scan { depth_mm: 0.5, rise_s: 0.01, speed_mm_s: 20.0, direction_deg: 0.0, duration_s: 1.6 };
            let touch = Touch::scan(Pose { y_mm: 1.0, ..Pose::default() }, scan).unwrap();
            let contact = contact(&shape, &touch);
            let near = nearness(Array::paper(), &contact, &touch, 500);
            // The pin at [1.45, 1.45].
            assert_eq!(passes(near.iter().map(|near| near[10])).len(), strokes, "{shape:?}");
            let levels = stroke(Array::paper(), &contact, &touch, &near);
            let moves = levels.heights_mm.windows(2).filter(|pair| pair[1][10] > pair[0][10]).count();
            assert!((1..=9 * strokes).contains(&moves), "{shape:?}: {moves}");
        }
    }

    #[test]
    fn a_press_rises_at_once_and_comes_down_when_the_depth_falls_however_slowly() {
        for fall_s in [0.05, 1.0] {
            let press = Press { depth_mm: 0.5, rise_s: 0.2, hold_s: 0.1, fall_s };
            let touch = Touch::press(Pose::default(), press).unwrap();
            let contact = contact(&Shape::Dots(vec![[1.45, 1.45]]), &touch);
            let near = nearness(Array::paper(), &contact, &touch, 400);
            let levels = super::press(Array::paper(), &contact, &touch, &near);
            let up = |t_s: f64| levels.heights_mm[(t_s / STEP_S) as usize][10];
            assert!(up(0.05) > 0.39 && up(0.3) > 0.39 && up(0.36) < 0.01, "{fall_s}: {}", up(0.36));
        }
    }
}
