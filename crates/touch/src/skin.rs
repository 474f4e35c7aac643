//! The displacement of the skin under an object through a touch.

use crate::contact::{Contact, distance};
use crate::field::Field;
use crate::timeline::Timeline;
use crate::touch::{Frame, Touch};
use meissner_skin::afferents::{ELASTICITY, POISSON};
use rayon::prelude::*;

/// The displacement of the skin, mm, inward, by place and then by time. Places are `[x, y]` on the skin in mm, times in s.
pub fn displacements_mm(
    contact: &Contact,
    touch: &Touch,
    places_mm: &[[f64; 2]],
    times_s: &[f64],
) -> Vec<Vec<f64>> {
    let timeline = Timeline::new(contact, touch, times_s.iter().copied());
    let per_spread = (1.0 - POISSON * POISSON) / ELASTICITY;
    if touch.stays_in_place() {
        let frame = Frame::of(&touch.pose(0.0));
        let (punch, grains) = (contact.grains().punch(), contact.grains());
        let of = |at: &[f64; 2]| {
            let at = frame.inward(*at);
            let flexibility: Vec<f64> =
                grains.places_mm.iter().map(|place| punch.flexibility(distance(at, *place))).collect();
            let by_depth: Vec<f64> = (0..contact.depths())
                .map(|depth| contact.solved(depth).iter().zip(&flexibility).map(|(load, mm)| load * mm).sum())
                .collect();
            let mixed = timeline.weights.iter().map(|weights| {
                weights.iter().flatten().map(|&(number, weight)| weight * by_depth[number]).sum()
            });
            mixed.collect()
        };
        return places_mm.par_iter().map(of).collect();
    }
    let field = Field::<1>::new(contact, reach(&timeline, places_mm.iter().copied()));
    let of = |at: &[f64; 2]| {
        let moments = timeline.frames.iter().zip(&timeline.weights);
        moments.map(|(frame, weights)| per_spread * field.at(frame.inward(*at), weights)[0]).collect()
    };
    places_mm.par_iter().map(of).collect()
}

/// The box of an object's frame in which places on the skin lie through a touch: its lowest and highest x and y.
pub(crate) fn reach(timeline: &Timeline, places_mm: impl Iterator<Item = [f64; 2]>) -> [[f64; 2]; 2] {
    // The corners of the places' own box bound them in every pose.
    let [low, high] = bounds(places_mm);
    let corners = [low, high, [low[0], high[1]], [high[0], low[1]]];
    bounds(timeline.frames.iter().flat_map(|frame| corners.map(|corner| frame.inward(corner))))
}

/// The lowest and the highest x and y.
fn bounds(places: impl Iterator<Item = [f64; 2]>) -> [[f64; 2]; 2] {
    let start = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    let found = places.fold(start, |[low, high], at| {
        [[0, 1].map(|axis| low[axis].min(at[axis])), [0, 1].map(|axis| high[axis].max(at[axis]))]
    });
    if found[0][0] <= found[1][0] { found } else { [[0.0; 2]; 2] }
}
