//! Renders a touch: motions of pins that give a finger the response that a real object gives.
//!
//! [`render`] takes the contact of an object, its touch, and an array, and returns the heights of all pins over time. The data path:
//!
//! 1. `skin`: how far the skin moves, at places on a grid, for each pin that moves.
//! 2. `wanted`: how far the skin moves under the object, at the same places, moment by moment.
//! 3. `field`: heights whose skin is nearest to that of the object: one bounded least squares per moment.
//! 4. `strokes`: strokes of the pins that an object passes, as a start for objects that move.
//! 5. `rates`: the rates of RA and PC afferents that a motion of the skin gives, and how far those of some heights are from the
//!    object's. `descent` changes heights until both rates and skin are near the object's.
//! 6. `rule`: the plain answer, one press graded by the distance from the object. `rivals`: pins that vibrate near the object.
//!    `trace`: [`trace()`] moves a press along an object's lines, one after another, in place of the touch.
//! 7. `levels`: heights over time become a pattern.
//! 8. `poses`: [`Poses`] gives heights for one pose at a time, for poses that are not known before.
//! 9. `judge`: a [`Judge`] compares the response of a finger to a pattern with its response to the object, `blurred` over the skin.
//!    `observer`: an [`Observer`] names what a finger feels.
//!
//! Invariant: heights are within the travel of the array's motors, and no pin is asked to move faster than they do. Results depend on
//! the request alone, not on threads.

mod blurred;
mod descent;
mod field;
mod judge;
mod levels;
mod observer;
mod poses;
mod rates;
mod rivals;
mod rule;
mod skin;
mod strokes;
mod trace;
mod wanted;

pub use blurred::BLUR_MM;
pub use judge::{Judge, Judged, response_of};
pub use levels::{Levels, STEP_S};
pub use observer::{Observer, Reads};
pub use poses::{PART_MM, Poses, PosesError};
pub use rivals::Rival;
pub use trace::{LONGEST_S, TRACE_MM_S, TraceError, trace};

use descent::{Goal, Weights};
use meissner_array::spec::Array;
use meissner_touch::{Contact, Touch};

/// How heights are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// One press graded by the distance of each pin from the object.
    Rule,
    /// The skin's shape.
    Field,
    /// The rates of afferents, beginning with strokes of the pins that the object passes.
    Rate,
    /// The rates of afferents, beginning with the skin's shape; for an object that moves, also with strokes, whichever ends nearer.
    Auto,
}

/// Finds heights of an array's pins for an object's touch.
pub fn render(array: Array, contact: &Contact, touch: &Touch, method: Method) -> Levels {
    // An object that stays in place begins near its end.
    let steps = if touch.stays_in_place() { 20 } else { 60 };
    let skin = skin::Skin::new(array, skin::SPACING_MM);
    let limits = levels::Limits::of(array);
    let wanted = wanted::Wanted::new(&skin, contact, touch, limits);
    let goal = |weights| Goal::new(&skin, &wanted, weights);
    let strokes = |goal: &Goal<'_>| goal.nearest(strokes::starts(&skin, &wanted, limits));
    match method {
        Method::Rule => rule::press(array, contact, touch, wanted.moments()),
        Method::Field if touch.stays_in_place() => field::in_place(&skin, &wanted, limits),
        Method::Field => field::nearest(&skin, &wanted, limits),
        Method::Rate => {
            let goal = goal(Weights::MOVING);
            goal.descend(limits, strokes(&goal), steps).levels
        }
        Method::Auto if touch.stays_in_place() => {
            goal(Weights::IN_PLACE).descend(limits, field::in_place(&skin, &wanted, limits), steps).levels
        }
        // What moves slowly is followed, what moves fast is not: a third of the steps tells which.
        Method::Auto => {
            let goal = goal(Weights::MOVING);
            let try_out = |start| goal.descend(limits, start, steps / 3);
            let (strokes, followed) =
                (try_out(strokes(&goal)), try_out(field::nearest(&skin, &wanted, limits)));
            let nearer = if strokes.loss < followed.loss { strokes } else { followed };
            goal.descend(limits, nearer.levels, steps - steps / 3).levels
        }
    }
}
