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

/// The weights of a finger's afferents at each place.
#[derive(Clone, Debug)]
pub(crate) struct Blurred {
    places: usize,
    /// By class and afferent: its number, and its weights at the places where it counts. At each place they add up to 1.
    by_class: [Vec<(usize, Weights)>; 3],
}

/// Weights by place.
type Weights = Vec<(usize, f64)>;

impl Blurred {
    pub(crate) fn new(afferents: &[Afferent]) -> Self {
        Self::within(afferents, |_| true)
    }

    /// Only at some places.
    pub(crate) fn within(afferents: &[Afferent], is_within: impl Fn([f64; 2]) -> bool) -> Self {
        let places: Vec<_> = grid(SPACING_MM).into_iter().filter(|at| is_within(*at)).collect();
        let of_class = |class: Class| {
            let of_class = afferents.iter().enumerate().filter(|(_, of)| of.class == class);
            let weights = |(number, of): (usize, &Afferent)| {
                let at = [of.at.x_mm, of.at.y_mm];
                let all = places.iter().enumerate().map(|(place, from)| (place, weight(*from, at)));
                (number, all.filter(|(_, weight)| *weight > LEAST_WEIGHT).collect())
            };
            let mut rows: Vec<(usize, Weights)> = of_class.map(weights).collect();
            let mut sums = vec![0.0; places.len()];
            rows.iter().flat_map(|(_, row)| row).for_each(|(place, weight)| sums[*place] += weight);
            rows.iter_mut().flat_map(|(_, row)| row).for_each(|(place, weight)| *weight /= sums[*place]);
            rows
        };
        Self { places: places.len(), by_class: Class::ALL.map(of_class) }
    }

    /// The blurred numbers of a class, by place, of numbers by afferent. Most afferents are silent in a bin, and take no time.
    pub(crate) fn of_class(&self, class: Class, of_afferent: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut blurred = vec![0.0; self.places];
        for (number, row) in &self.by_class[class as usize] {
            let of_afferent = of_afferent(*number);
            if of_afferent != 0.0 {
                row.iter().for_each(|(place, weight)| blurred[*place] += weight * of_afferent);
            }
        }
        blurred
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
