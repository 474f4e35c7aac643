//! Of several answers for an object, the one that simulated fingers find nearest to it.
//!
//! The measure is the [likeness](crate::Judged::likeness), the mean over the fingers.

use crate::judge::{Judge, response_of};
use crate::levels::Levels;
use meissner_array::spec::Array;
use meissner_skin::Finger;
use meissner_touch::{Contact, Touch, respond};
use serde::Serialize;

/// The fingers that choose. None of them judges.
const FINGERS: [u64; 2] = [4000, 4001];
/// After the object has left, afferents are counted for so long, s.
const AFTER_S: f64 = 0.1;

/// What was chosen, and how near each answer comes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// The name of the answer that was taken.
    pub taken: &'static str,
    /// The likeness of each answer by its name, in the order in which they were tried: 1 is the object itself.
    pub likeness: Vec<(&'static str, f64)>,
}

/// The answer with the highest likeness; the first, if none is higher.
pub(crate) fn choose(
    array: Array,
    contact: &Contact,
    touch: &Touch,
    answers: Vec<(&'static str, Levels)>,
) -> (Levels, Choice) {
    let seconds = touch.duration_s() + AFTER_S;
    let fingers = FINGERS.map(Finger::new);
    // All at once: under an object that moves, the contact's tables take longer than the afferents.
    let afferents = fingers.each_ref().map(Finger::afferents).concat();
    let real_s = respond(contact, touch, &afferents, Some(0), &|_| ());
    let of_fingers = fingers.iter().zip(real_s.chunks(real_s.len() / FINGERS.len()));
    let judges: Vec<_> = of_fingers.map(|(finger, real_s)| Judge::new(finger, real_s, seconds)).collect();
    let likeness = |levels: &Levels| -> f64 {
        let Ok(pattern) = levels.pattern(array, "answer", toml::Table::new()) else { return 0.0 };
        let of_finger = |(finger, judge): (&Finger, &Judge<'_>)| {
            let felt_s = response_of(finger, &pattern, seconds, 1).unwrap_or_default();
            judge.compare(&felt_s).likeness()
        };
        fingers.iter().zip(&judges).map(of_finger).sum::<f64>() / FINGERS.len() as f64
    };
    let likeness: Vec<_> = answers.iter().map(|(name, levels)| (*name, likeness(levels))).collect();
    let most = likeness.iter().map(|(_, likeness)| *likeness).fold(f64::NEG_INFINITY, f64::max);
    let taken = likeness.iter().position(|(_, likeness)| *likeness == most).unwrap_or(0);
    let choice = Choice { taken: likeness[taken].0, likeness };
    (answers.into_iter().nth(taken).map(|(_, levels)| levels).unwrap_or_default(), choice)
}
