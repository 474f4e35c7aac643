//! Of several answers for an object, the one that simulated fingers find nearest to it.
//!
//! The measure is the [likeness](crate::Judged::likeness), the mean over the fingers.

use crate::judge::{Judge, response_of};
use crate::levels::Levels;
use meissner_array::spec::Array;
use meissner_skin::Finger;
use meissner_touch::{Contact, Touch, respond};
use serde::Serialize;
use std::collections::BTreeMap;

/// The fingers that choose. None of them judges.
const FINGERS: [u64; 2] = [4000, 4001];
/// After the object has left and the pins have come down, afferents are counted for so long, s.
const AFTER_S: f64 = 0.1;

/// What was chosen, and how near each answer comes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// The name of the answer that was taken.
    pub taken: &'static str,
    /// The likeness of each answer that can be played, by its name. The object felt again has some 0.8.
    pub likeness: BTreeMap<&'static str, f64>,
}

/// The answer with the highest likeness; the first, if none is higher.
pub(crate) fn choose(
    array: Array,
    contact: &Contact,
    touch: &Touch,
    answers: Vec<(&'static str, Levels)>,
) -> (Levels, Choice) {
    let lasts_s = answers.iter().map(|(_, levels)| levels.duration_s()).fold(touch.duration_s(), f64::max);
    let seconds = lasts_s + AFTER_S;
    let fingers = FINGERS.map(Finger::new);
    // All at once: under an object that moves, the contact's tables take longer than the afferents.
    let afferents = fingers.each_ref().map(Finger::afferents).concat();
    let real_s = respond(contact, touch, &afferents, Some(0), &|_| ());
    let of_fingers = fingers.iter().zip(real_s.chunks(fingers[0].afferents().len()));
    let judges: Vec<_> = of_fingers.map(|(finger, real_s)| Judge::new(finger, real_s, seconds)).collect();
    let likeness = |levels: &Levels| -> Option<f64> {
        let pattern = levels.pattern(array, "answer", toml::Table::new()).ok()?;
        let mut sum = 0.0;
        for (finger, judge) in fingers.iter().zip(&judges) {
            sum += judge.compare(&response_of(finger, &pattern, seconds, 1).ok()?).likeness();
        }
        Some(sum / FINGERS.len() as f64)
    };
    let mut choice = Choice { taken: "", likeness: BTreeMap::new() };
    let (mut taken, mut most) = (Levels::default(), f64::NEG_INFINITY);
    for (name, levels) in answers {
        let likeness = likeness(&levels);
        choice.likeness.extend(likeness.map(|likeness| (name, likeness)));
        if choice.taken.is_empty() || likeness.is_some_and(|likeness| likeness > most) {
            (choice.taken, taken) = (name, levels);
            most = likeness.unwrap_or(most);
        }
    }
    (taken, choice)
}
