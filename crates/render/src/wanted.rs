//! How far the skin moves under an object, at the places of a [`Skin`], moment by moment.

use crate::levels::{Limits, STEP_S};
use crate::skin::Skin;
use meissner_touch::{Contact, Touch, displacements_mm};

/// The displacement of the skin under an object.
#[derive(Clone, Debug)]
pub(crate) struct Wanted {
    /// By moment and then by place, mm.
    pub(crate) skin_mm: Vec<Vec<f64>>,
    /// Moments of the touch itself: at the later ones pins come down, and nothing is asked of afferents.
    pub(crate) touched: usize,
}

impl Wanted {
    /// After the touch, the skin is at rest until pins that are at their travel have come down.
    pub(crate) fn new(skin: &Skin, contact: &Contact, touch: &Touch, limits: Limits) -> Self {
        let moments = touched(touch);
        let times_s: Vec<f64> = (0..moments).map(|moment| moment as f64 * STEP_S).collect();
        let by_place = displacements_mm(contact, touch, &skin.places_mm, &times_s);
        let at = |moment: usize| by_place.iter().map(|place| place[moment]).collect();
        let rest = vec![vec![0.0; skin.places()]; self::moments(touch, limits) - moments];
        Self { skin_mm: (0..moments).map(at).chain(rest).collect(), touched: moments }
    }
}

/// Moments of a touch itself.
fn touched(touch: &Touch) -> usize {
    (touch.duration_s() / STEP_S).ceil() as usize + 1
}

/// Moments of a touch, and those in which pins that are at their travel come down.
pub(crate) fn moments(touch: &Touch, limits: Limits) -> usize {
    touched(touch) + (limits.highest_mm / limits.step_mm).ceil() as usize
}
