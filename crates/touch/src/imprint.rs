//! The displacement of the skin about an object, as a table in the object's frame: for poses that are not known before.
//!
//! [`Imprint::new`] convolves the loads of each solved depth with the skin's flexibility on the grid of the grains.
//! [`Imprint::displacements_mm`] then looks up places at any pose, by bicubics with continuous slopes (Catmull & Rom).
//!
//! At the middle of a grain that presses, the table has the grain's own depth. Between grains it has none of their roughness.
//!
//! Invariant: a look-up costs the same wherever the object is and however many grains it has.

use crate::contact::{Contact, ContactError, MAX_BYTES, cubic};
use crate::fft::{Convolution, Plan, Work, padded};
use crate::touch::{Frame, Pose};

/// Points beyond the reach that an interpolation takes.
const BEYOND: f64 = 3.0;

/// The skin about an object, for each solved depth.
#[derive(Clone, Debug)]
pub struct Imprint {
    contact: Contact,
    reach_mm: f64,
    /// The first point.
    low: [f64; 2],
    size: [usize; 2],
    /// By row, column and solved depth, mm.
    values_mm: Vec<f32>,
}

impl Imprint {
    /// The skin within `reach_mm` of the origin of the object's frame, along each axis.
    ///
    /// # Errors
    /// If it takes more than [`MAX_BYTES`].
    pub fn new(contact: Contact, reach_mm: f64) -> Result<Self, ContactError> {
        let (grains, depths) = (contact.grains(), contact.depths());
        let pitch_mm = grains.pitch_mm;
        let steps = |axis: usize, at: f64| (at - grains.origin_mm[axis]) / pitch_mm;
        let first = [0, 1].map(|axis| (steps(axis, -reach_mm) - BEYOND).floor().min(0.0));
        let last = [0, 1].map(|axis| (steps(axis, reach_mm) + BEYOND).ceil().max(0.0));
        let size = [0, 1].map(|axis| (last[axis] - first[axis]) as usize + 1);
        let lead = first.map(|first| -first as usize);
        let [columns, rows] = padded(grains.size, size);
        // The kernel's spectrum, and the two grids of `Work`; and the table.
        let bytes = 3 * 16 * columns * rows + 4 * size[0] * size[1] * depths;
        if bytes > MAX_BYTES {
            return Err(ContactError::TooLarge { grains: grains.len(), pitch_mm, bytes });
        }
        let plan = Plan::new(grains.size, size);
        let punch = grains.punch();
        let kernel = |[x, y]: [f64; 2]| punch.flexibility(pitch_mm * (x * x + y * y).sqrt());
        let skin = Convolution::new(plan, grains.size, size, lead, kernel);
        let mut values_mm = vec![0.0; size[0] * size[1] * depths];
        let mut work = Work::default();
        // Two depths at a time.
        for depth in (0..depths).step_by(2) {
            let second =
                |grain: usize| if depth + 1 < depths { contact.solved(depth + 1)[grain] } else { 0.0 };
            let of = |(grain, &cell): (usize, _)| (cell, [contact.solved(depth)[grain], second(grain)]);
            let found = skin.of(grains.cells.iter().enumerate().map(of), &mut work);
            for (point, values_mm) in values_mm.chunks_exact_mut(depths).enumerate() {
                let found = found([point % size[0], point / size[0]]);
                values_mm[depth..].iter_mut().zip(found).for_each(|(mm, found)| *mm = found as f32);
            }
        }
        let low = [0, 1].map(|axis| grains.origin_mm[axis] + first[axis] * pitch_mm);
        Ok(Self { contact, reach_mm, low, size, values_mm })
    }

    /// The contact.
    pub const fn contact(&self) -> &Contact {
        &self.contact
    }

    /// The displacement of the skin, mm, inward, at places on the skin, `[x, y]` in mm, with the object at a pose. A place beyond the
    /// reach counts as the nearest one within it.
    pub fn displacements_mm(&self, pose: &Pose, places_mm: &[[f64; 2]]) -> Vec<f64> {
        let (frame, weights) = (Frame::of(pose), self.contact.weights(pose.depth_mm));
        let depths = self.contact.depths();
        let of = |at: &[f64; 2]| {
            let at = frame.inward(*at).map(|mm| mm.clamp(-self.reach_mm, self.reach_mm));
            let point = [0, 1].map(|axis| (at[axis] - self.low[axis]) / self.contact.grains().pitch_mm);
            let [across, along] = point.map(|place| cubic(place - place.floor()));
            let [column, row] = point.map(|place| place.floor() as usize - 1);
            let mut sum = 0.0;
            for (line, along) in along.iter().enumerate() {
                let start = ((row + line) * self.size[0] + column) * depths;
                for (point, across) in across.iter().enumerate() {
                    let values_mm = &self.values_mm[start + point * depths..][..depths];
                    let mixed = weights
                        .iter()
                        .flatten()
                        .map(|&(number, weight)| weight * f64::from(values_mm[number]));
                    sum += along * across * mixed.sum::<f64>();
                }
            }
            sum
        };
        places_mm.iter().map(of).collect()
    }
}
