//! Responses blurred over the skin: what is common to different fingers.
//!
//! At each place of a grid, and for each class, the response is the mean over the afferents of the class, with a Gaussian weight of their
//! distance.

use crate::skin::{SPACING_MM, grid};
use meissner_skin::afferents::{Afferent, Class};

/// Blur over the skin, mm (SD).
pub const BLUR_MM: f64 = 1.5;
/// A smaller weight counts as 0.
const LEAST_WEIGHT: f64 = 1e-6;

/// A Gaussian weight of a distance between two places.
pub(crate) fn weight([x, y]: [f64; 2], [a, b]: [f64; 2]) -> f64 {
    let squared = (a - x) * (a - x) + (b - y) * (b - y);
    libm::exp(-squared / (2.0 * BLUR_MM * BLUR_MM))
}

/// The weights of a finger's afferents at each place, by class.
#[derive(Clone, Debug)]
pub(crate) struct Blurred {
    /// By class and place: the afferents that count, and their weights, which add up to 1.
    by_class: [Vec<Vec<(usize, f64)>>; 3],
}

impl Blurred {
    pub(crate) fn new(afferents: &[Afferent]) -> Self {
        Self::within(afferents, |_| true)
    }

    /// Only at some places.
    pub(crate) fn within(afferents: &[Afferent], is_within: impl Fn([f64; 2]) -> bool) -> Self {
        let places: Vec<_> = grid(SPACING_MM).into_iter().filter(|at| is_within(*at)).collect();
        let at_place = |class: Class, place: [f64; 2]| {
            let of_class = afferents.iter().enumerate().filter(|(_, of)| of.class == class);
            let weighed = of_class.map(|(number, of)| (number, weight(place, [of.at.x_mm, of.at.y_mm])));
            let mut row: Vec<_> = weighed.filter(|(_, weight)| *weight > LEAST_WEIGHT).collect();
            let sum: f64 = row.iter().map(|(_, weight)| weight).sum();
            row.iter_mut().for_each(|(_, weight)| *weight /= sum);
            row
        };
        Self {
            by_class: Class::ALL.map(|class| places.iter().map(|&place| at_place(class, place)).collect()),
        }
    }

    /// The blurred numbers of a class, by place, of numbers by afferent.
    pub(crate) fn of_class(&self, class: Class, of_afferent: impl Fn(usize) -> f64) -> Vec<f64> {
        let mean =
            |row: &Vec<(usize, f64)>| row.iter().map(|&(number, weight)| weight * of_afferent(number)).sum();
        self.by_class[class as usize].iter().map(mean).collect()
    }
}

/// Each afferent's spikes in some bins, from times in s.
pub(crate) fn counts(spikes_s: &[Vec<f64>], bin_s: f64, bins: usize) -> Vec<Vec<f64>> {
    let of_afferent = |times_s: &Vec<f64>| {
        let mut counts = vec![0.0; bins];
        for at in times_s {
            if let Some(count) = counts.get_mut((at / bin_s) as usize) {
                *count += 1.0;
            }
        }
        counts
    };
    spikes_s.iter().map(of_afferent).collect()
}
