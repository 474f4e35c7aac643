//! Heights for an object that stays in place, or moves slowly.
//!
//! The skin's shape ([`field`]) gives SA1 and RA afferents their spikes, but pins that are at their travel flatten it, which turns
//! lines at some places. A press graded by the distance ([`rule`](crate::rule)) keeps the line and lacks the spikes. Some of each has most of both.
//!
//! PC afferents answer where speed changes. Motors smooth such corners over 4 ms, so each corner of a pin's course gets a *tap*: for a moment
//! the pin is higher, by as much as its way in a moment changes there (after the transients of Kuchenbecker, Fiene & Niemeyer 2006).
//!
//! # Source
//!
//! K. J. Kuchenbecker, J. Fiene and G. Niemeyer, "Improving contact realism through event-based haptic feedback", *IEEE Transactions on
//! Visualization and Computer Graphics* 12, 219-230, 2006.

use crate::field;
use crate::levels::{Levels, Limits, STEP_S};
use crate::skin::Skin;
use crate::wanted::Wanted;
use meissner_touch::Touch;

/// The share of the skin's shape, and that of the graded press. They add up to more than 1: under the object both go the travel, and beside it half
/// of each would be too low for RA afferents.
const SHARE: f64 = 0.75;

/// The skin's shape and a graded press, with taps.
pub(crate) fn tapped(
    skin: &Skin,
    touch: &Touch,
    wanted: &Wanted,
    near: &[Vec<f64>],
    limits: Limits,
) -> Levels {
    let mut levels = field::in_time(skin, wanted, limits.highest_mm);
    for (moment, (heights, near)) in levels.heights_mm.iter_mut().zip(near).enumerate() {
        let depth = touch.pose(moment as f64 * STEP_S).depth_mm / touch.most_depth_mm();
        for (height, near) in heights.iter_mut().zip(near) {
            *height = SHARE * (*height + depth * near * limits.highest_mm);
        }
    }
    limit(&mut levels, limits);
    tap(&mut levels);
    // Pins at their travel would make no tap: their course becomes lower.
    limit(&mut levels, limits);
    levels
}

/// Brings heights within what motors do. A pin that would go beyond its travel keeps its time course.
fn limit(levels: &mut Levels, limits: Limits) {
    let motors = levels.heights_mm.first().map_or(0, Vec::len);
    for motor in 0..motors {
        let highest_mm = levels.heights_mm.iter().map(|heights| heights[motor]).fold(0.0, f64::max);
        let share = (limits.highest_mm / highest_mm).min(1.0);
        levels.heights_mm.iter_mut().for_each(|heights| heights[motor] *= share);
    }
    levels.limit(limits);
}

/// Adds a tap at each corner. At the first moment pins rest, so the tap of a course that begins there is one moment late, as far as the motors
/// are fast enough.
fn tap(levels: &mut Levels) {
    let before = levels.heights_mm.clone();
    for (moment, three) in before.windows(3).enumerate() {
        let is_first = moment == 0;
        for (motor, height) in levels.heights_mm[moment + 1].iter_mut().enumerate() {
            let [a, b, c] = [0, 1, 2].map(|of| three[of][motor]);
            let begins = if is_first { b } else { 0.0 };
            *height += (a - 2.0 * b + c).abs() + begins;
        }
    }
}
