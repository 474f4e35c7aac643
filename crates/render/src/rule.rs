//! The plain answers: pins that press as far as they are near the object, at full speed.
//!
//! [`press`] holds them up: for an object that stays in place from the touch until the depth falls, for one that moves it follows. [`stroke`]
//! makes one stroke of each pin as the object passes it.

use crate::levels::{Levels, Limits, STEP_S};
use meissner_array::spec::Array;
use meissner_touch::{Contact, Pose, Touch};

/// How far a press reaches beyond the object, mm (SD of a Gaussian).
const REACH_MM: f64 = 1.3;
/// A lower top is no stroke, mm.
const LEAST_MM: f64 = 0.02;

/// Pins press while the object does.
pub(crate) fn press(array: Array, contact: &Contact, touch: &Touch, moments: usize) -> Levels {
    let limits = Limits::of(array);
    if !touch.stays_in_place() {
        let mut levels = Levels { heights_mm: graded(array, contact, touch, moments) };
        levels.limit(limits);
        return levels;
    }
    let tops_mm = tops_mm(array, contact, touch);
    let depth_mm = |moment: usize| touch.pose((moment as f64 * STEP_S).min(touch.duration_s())).depth_mm;
    let mut levels = Levels::at_rest(moments, array.motors());
    for moment in 1..moments {
        let (before_mm, now_mm) = (depth_mm(moment - 1), depth_mm(moment));
        // A depth that falls by less than a hundredth in a moment counts as held.
        let is_up = now_mm > 0.0 && before_mm - now_mm < 0.01 * touch.most_depth_mm();
        for (motor, top_mm) in tops_mm.iter().enumerate() {
            let (from_mm, to_mm) = (levels.heights_mm[moment - 1][motor], if is_up { *top_mm } else { 0.0 });
            let way_mm = (to_mm - from_mm).clamp(-limits.step_mm, limits.step_mm);
            levels.heights_mm[moment][motor] = from_mm + way_mm;
        }
    }
    levels.limit(limits);
    levels
}

/// Each pin makes a stroke about each moment at which the object is nearest to it. An object that stays in place is pressed.
pub(crate) fn stroke(array: Array, contact: &Contact, touch: &Touch, moments: usize) -> Levels {
    if touch.stays_in_place() {
        return press(array, contact, touch, moments);
    }
    let limits = Limits::of(array);
    let near_mm = graded(array, contact, touch, moments);
    let mut levels = Levels::at_rest(moments, array.motors());
    for motor in 0..array.motors() {
        let mut first = 0;
        let course: Vec<f64> = near_mm.iter().map(|heights| heights[motor]).collect();
        let (mut before_mm, mut runs) = (0.0, course.chunk_by(|a, b| a == b).peekable());
        while let Some(run) = runs.next() {
            let (top_mm, middle) = (run[0], first as f64 + (run.len() - 1) as f64 / 2.0);
            let after_mm = runs.peek().map_or(0.0, |next| next[0]);
            if top_mm > LEAST_MM && top_mm > before_mm && top_mm > after_mm {
                for (moment, heights) in levels.heights_mm.iter_mut().enumerate() {
                    let tent_mm = top_mm - limits.step_mm * (moment as f64 - middle).abs();
                    heights[motor] = heights[motor].max(tent_mm);
                }
            }
            (before_mm, first) = (top_mm, first + run.len());
        }
    }
    levels.limit(limits);
    levels
}

/// The height of each pin where the object lies at its deepest, mm.
fn tops_mm(array: Array, contact: &Contact, touch: &Touch) -> Vec<f64> {
    let pose = Pose { depth_mm: touch.most_depth_mm(), ..touch.pose(0.0) };
    let height = |pin: &[f64; 2]| near(contact, &pose, *pin) * Limits::of(array).highest_mm;
    array.positions_mm().iter().map(height).collect()
}

/// The heights of pins by how near the object is, at each moment of the touch, mm; 0 after it.
pub(crate) fn graded(array: Array, contact: &Contact, touch: &Touch, moments: usize) -> Vec<Vec<f64>> {
    let highest_mm = Limits::of(array).highest_mm;
    let mut before: Option<(Pose, Vec<f64>)> = None;
    let at = |moment: usize| {
        let t_s = moment as f64 * STEP_S;
        if t_s > touch.duration_s() {
            return vec![0.0; array.motors()];
        }
        let pose = touch.pose(t_s);
        match &before {
            Some((same, heights)) if *same == pose => heights.clone(),
            _ => {
                let height = |pin: &[f64; 2]| highest_mm * near(contact, &pose, *pin);
                let heights: Vec<f64> = array.positions_mm().iter().map(height).collect();
                before = Some((pose, heights.clone()));
                heights
            }
        }
    };
    (0..moments).map(at).collect()
}

/// How near the object is to a pin: 1 if it touches it.
fn near(contact: &Contact, pose: &Pose, pin: [f64; 2]) -> f64 {
    let beyond_mm = beyond_mm(contact, pose, pin);
    libm::exp(-beyond_mm * beyond_mm / (2.0 * REACH_MM * REACH_MM))
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
