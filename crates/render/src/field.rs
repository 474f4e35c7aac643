//! Heights whose skin is nearest to that of the object, moment by moment.
//!
//! Each moment is a least squares with the same matrix, with heights between 0 and the travel: [`Boxed`], by accelerated projected
//! gradients (Beck & Teboulle 2009) that begin at the heights of the moment before.
//!
//! # Source
//!
//! A. Beck and M. Teboulle, "A fast iterative shrinkage-thresholding algorithm for linear inverse problems", *SIAM Journal on Imaging
//! Sciences* 2, 183-202, 2009.

use crate::levels::{Levels, Limits};
use crate::skin::{Skin, dot};
use crate::wanted::Wanted;

/// Added to the sum of squares per square of a height. It keeps heights small where places hardly tell pins apart.
pub(crate) const DAMPING: f64 = 1e-3;
/// Steps per moment.
const STEPS: usize = 60;

/// Least squares of what is wanted at the places, with bounded heights.
#[derive(Debug)]
pub(crate) struct Boxed<'s> {
    skin: &'s Skin,
    matrix: Vec<Vec<f64>>,
    /// No eigenvalue of the matrix is larger.
    largest: f64,
}

impl<'s> Boxed<'s> {
    pub(crate) fn new(skin: &'s Skin, damping: f64) -> Self {
        let matrix = skin.products(damping);
        let sum = |row: &Vec<f64>| row.iter().map(|value| value.abs()).sum::<f64>();
        let largest = matrix.iter().map(sum).fold(0.0, f64::max);
        Self { skin, matrix, largest }
    }

    /// Brings heights from where they are to the best within 0 to `highest`.
    pub(crate) fn solve(&self, wanted: &[f64], highest: f64, heights: &mut [f64]) {
        let mut wish = vec![0.0; heights.len()];
        self.skin.onto(wanted, &mut wish);
        let (mut ahead, mut pace) = (heights.to_vec(), 1.0_f64);
        for _ in 0..STEPS {
            let slope = |(row, wish): (&Vec<f64>, &f64)| dot(row, &ahead) - wish;
            let slopes: Vec<f64> = self.matrix.iter().zip(&wish).map(slope).collect();
            let next_pace = f64::midpoint(1.0, (1.0 + 4.0 * pace * pace).sqrt());
            let carry = (pace - 1.0) / next_pace;
            for ((height, ahead), slope) in heights.iter_mut().zip(&mut ahead).zip(slopes) {
                let next = (*ahead - slope / self.largest).clamp(0.0, highest);
                *ahead = next + carry * (next - *height);
                *height = next;
            }
            pace = next_pace;
        }
    }
}

/// The heights nearest to the wanted skin.
pub(crate) fn nearest(skin: &Skin, wanted: &Wanted, limits: Limits) -> Levels {
    let mut levels = solved(skin, wanted, limits.highest_mm);
    levels.limit(limits);
    levels
}

/// The same for an object that stays in place.
pub(crate) fn in_place(skin: &Skin, wanted: &Wanted, limits: Limits) -> Levels {
    let mut levels = in_time(skin, wanted, limits.highest_mm);
    levels.limit(limits);
    levels
}

/// Heights up to the highest. A pin that would have to go further goes so far in the time course that it would have without that limit: a pin
/// that stops early is felt by PC afferents, and begins its fall too late.
pub(crate) fn in_time(skin: &Skin, wanted: &Wanted, highest_mm: f64) -> Levels {
    let bounded = solved(skin, wanted, highest_mm);
    let mut levels = solved(skin, wanted, f64::INFINITY);
    let peak = |levels: &Levels, motor: usize| {
        levels.heights_mm.iter().map(|heights| heights[motor]).fold(0.0, f64::max)
    };
    for motor in 0..skin.motors {
        let (reached, wished) = (peak(&bounded, motor), peak(&levels, motor));
        if wished > 0.0 {
            levels.heights_mm.iter_mut().for_each(|heights| heights[motor] *= reached / wished);
        }
    }
    levels
}

fn solved(skin: &Skin, wanted: &Wanted, highest_mm: f64) -> Levels {
    let boxed = Boxed::new(skin, DAMPING);
    let mut heights = vec![0.0; skin.motors];
    let mut at_each = |skin_mm: &Vec<f64>| {
        boxed.solve(skin_mm, highest_mm, &mut heights);
        heights.clone()
    };
    Levels { heights_mm: wanted.skin_mm.iter().map(&mut at_each).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skin::SPACING_MM;
    use meissner_array::spec::Array;

    /// What pins have done to the skin, pins can do again.
    #[test]
    fn the_skin_that_pins_made_gives_their_heights() {
        let skin = Skin::new(Array::paper(), SPACING_MM);
        let wished: Vec<f64> = (0..24).map(|motor| 0.3 * libm::sin(f64::from(motor)).max(0.0)).collect();
        let mut skin_mm = vec![0.0; skin.places()];
        skin.under(&wished, &mut skin_mm);
        let found = solved(&skin, &Wanted { skin_mm: vec![skin_mm; 5], touched: 5 }, 0.4);
        for (motor, (found, wished)) in found.heights_mm[4].iter().zip(&wished).enumerate() {
            assert!((found - wished).abs() < 0.002, "motor {motor}: {found} for {wished}");
        }
    }

    #[test]
    fn heights_stay_within_the_travel() {
        let skin = Skin::new(Array::paper(), SPACING_MM);
        let limits = Limits::of(Array::paper());
        let wanted = Wanted { skin_mm: vec![vec![2.0; skin.places()]; 40], touched: 40 };
        for levels in [nearest(&skin, &wanted, limits), in_place(&skin, &wanted, limits)] {
            let all = || levels.heights_mm.iter().flatten();
            assert!(all().all(|&mm| (0.0..=limits.highest_mm).contains(&mm)));
            assert!(all().any(|&mm| mm > 0.9 * limits.highest_mm));
            assert!([0, 39].iter().all(|&end| levels.heights_mm[end] == [0.0; 24]));
        }
    }
}
