//! Renders a touch: motions of pins that give a finger the response that a real object gives.
//!
//! [`render`] takes the contact of an object, its touch, and an array, and returns the heights of all pins over time. The data path:
//!
//! 1. `skin`: how far the skin moves, at places on a grid, for each pin that moves.
//! 2. `wanted`: how far the skin moves under the object, at the same places, moment by moment.
//! 3. `field`: heights whose skin is nearest to that of the object: one bounded least squares per moment.
//! 4. `rule`: the plain answers, a press graded by the distance from the object and a stroke as it passes. `rivals`: pins that vibrate
//!    near the object. `trace`: [`trace()`] moves a press along an object's lines, one after another, in place of the touch.
//! 5. `press`: field and rule together, with a tap at each corner.
//! 6. `strokes`: strokes of the pins that an object passes, as a start for objects that move. `rates`: the rates of RA and PC afferents
//!    that a motion of the skin gives. `descent` changes heights until rates and skin are near the object's.
//! 7. `choice`: of several answers, the one that two simulated fingers find nearest to the object.
//! 8. `levels`: heights over time become a pattern.
//! 9. `poses`: [`Poses`] gives heights for one pose at a time, for poses that are not known before.
//! 10. `judge`: a [`Judge`] compares the response of a finger to a pattern with its response to the object, `blurred` over the skin.
//!     `observer`: an [`Observer`] names what a finger feels.
//!
//! Invariant: heights are within the travel of the array's motors, and no pin is asked to move faster than they do. Results depend on
//! the request alone, not on threads.

mod blurred;
mod choice;
mod descent;
mod field;
mod judge;
mod levels;
mod observer;
mod poses;
mod press;
mod rates;
mod rivals;
mod rule;
mod skin;
mod strokes;
mod trace;
mod wanted;

pub use blurred::BLUR_MM;
pub use choice::Choice;
pub use judge::{Judge, Judged, ramps_of, response_of};
pub use levels::{Levels, STEP_S};
pub use observer::{Observer, Reads};
pub use poses::{PART_MM, Poses, PosesError};
pub use rivals::Rival;
pub use trace::{LONGEST_S, TRACE_MM_S, TraceError, trace};

use choice::choose;
use descent::Goal;
use meissner_array::spec::Array;
use meissner_touch::{Contact, Touch};
use std::cell::LazyCell;

/// How heights are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// One press graded by the distance of each pin from the object. It follows an object that moves.
    Rule,
    /// One stroke of each pin as the object passes it; a press, if it stays in place.
    Stroke,
    /// The skin's shape.
    Field,
    /// The rates of afferents, beginning with strokes of the pins that the object passes.
    Rate,
    /// What two simulated fingers find nearest to the object: a press with taps, or `Rule`; for an object that moves also `Stroke` and the rates of
    /// afferents, beginning with strokes or with the skin's shape.
    Auto,
}

/// Steps of a descent.
const STEPS: usize = 60;

/// Finds heights of an array's pins for an object's touch. `Auto` also says what it has chosen.
pub fn render(array: Array, contact: &Contact, touch: &Touch, method: Method) -> (Levels, Option<Choice>) {
    let limits = levels::Limits::of(array);
    let near = || rule::nearness(array, contact, touch, wanted::moments(touch, limits));
    match method {
        Method::Rule => return (rule::press(array, contact, touch, &near()), None),
        Method::Stroke => return (rule::stroke(array, contact, touch, &near()), None),
        Method::Field | Method::Rate | Method::Auto => {}
    }
    let skin = skin::Skin::new(array, skin::SPACING_MM);
    let wanted = wanted::Wanted::new(&skin, contact, touch, limits);
    let goal = LazyCell::new(|| Goal::new(&skin, &wanted));
    let strokes = || goal.nearest(strokes::starts(&skin, &wanted, limits));
    let levels = match method {
        Method::Rate => goal.descend(limits, strokes(), STEPS),
        Method::Auto => {
            let near = near();
            let mut answers = vec![("press", press::tapped(&skin, touch, &wanted, &near, limits))];
            if !touch.stays_in_place() {
                // What moves slowly is followed, what moves fast is not: a third of the steps tells which.
                let starts = [strokes(), field::nearest(&skin, &wanted, limits)];
                let tried = starts.map(|start| goal.descend(limits, start, STEPS / 3)).to_vec();
                let nearer = Goal::of_start(&skin, &wanted).nearest(tried);
                let rate = goal.descend(limits, nearer, STEPS - STEPS / 3);
                answers.extend([("rate", rate), ("stroke", rule::stroke(array, contact, touch, &near))]);
            }
            answers.push(("rule", rule::press(array, contact, touch, &near)));
            let (levels, choice) = choose(array, contact, touch, answers);
            return (levels, Some(choice));
        }
        _ if touch.stays_in_place() => field::in_place(&skin, &wanted, limits),
        _ => field::nearest(&skin, &wanted, limits),
    };
    (levels, None)
}
