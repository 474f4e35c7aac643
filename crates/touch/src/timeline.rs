//! A touch, sample by sample: where the object is, and the weights of the solved depths.

use crate::contact::{Contact, Weights};
use crate::touch::{Frame, Touch};

/// An object's frame and loads at each of some times.
#[derive(Clone, Debug)]
pub(crate) struct Timeline {
    pub(crate) frames: Vec<Frame>,
    pub(crate) weights: Vec<Weights>,
}

impl Timeline {
    pub(crate) fn new(contact: &Contact, touch: &Touch, times_s: impl Iterator<Item = f64>) -> Self {
        let of = |t_s: f64| {
            let pose = touch.pose(t_s);
            (Frame::of(&pose), contact.weights(pose.depth_mm))
        };
        let (frames, weights) = times_s.map(of).unzip();
        Self { frames, weights }
    }

    pub(crate) const fn len(&self) -> usize {
        self.frames.len()
    }
}
