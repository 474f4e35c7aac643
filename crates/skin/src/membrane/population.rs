//! The RA afferents of a fingertip, scattered over the pad.
//!
//! The pad is an ellipse on the middle of the array. Its upper half, towards the fingertip, is denser. The number of afferents in a
//! half is fixed. Their positions are uniform over the half. Each position depends only on the seed and the afferent's number.
//!
//! Invariant: the same seed gives the same positions, bit for bit, on every machine.

use super::model::Position;
use meissner_array::random;
use std::f64::consts::PI;

/// Length of the pad, along y, mm (C).
pub const PAD_LENGTH_MM: f64 = 24.0;
/// Width of the pad, along x, mm (C).
pub const PAD_WIDTH_MM: f64 = 18.0;
/// Afferents per cm² of the upper half, y ≥ 0 (P).
pub const UPPER_PER_CM2: f64 = 140.0;
/// Afferents per cm² of the lower half (P).
pub const LOWER_PER_CM2: f64 = 40.0;

/// Separates these random numbers from others of the same seed; the simulated motors use 0 to 2.
const POSITION_WORD: u64 = 3;

/// The positions of 306 afferents: 238 in the upper half, then 68 in the lower.
pub fn population(seed: u64) -> Vec<Position> {
    scattered(seed, [UPPER_PER_CM2, LOWER_PER_CM2], POSITION_WORD)
}

/// Positions of afferents with these densities of the upper and the lower half, per cm². `word` separates the random numbers from
/// others.
pub(crate) fn scattered(seed: u64, per_cm2: [f64; 2], word: u64) -> Vec<Position> {
    let [upper, lower] = per_cm2.map(count);
    let position = |number| {
        let [area, turns] = random::uniform([seed, number, 0, word]);
        // The square root makes equal areas of the ellipse equally likely.
        let (radius, angle) = (area.sqrt(), PI * turns);
        let x_mm = PAD_WIDTH_MM / 2.0 * radius * libm::cos(angle);
        let y_mm = PAD_LENGTH_MM / 2.0 * radius * libm::sin(angle);
        Position { x_mm, y_mm: if number < upper { y_mm } else { -y_mm } }
    };
    (0..upper + lower).map(position).collect()
}

/// The number of afferents in half a pad.
fn count(per_cm2: f64) -> u64 {
    let half_pad_cm2 = PI / 4.0 * (PAD_LENGTH_MM / 10.0) * (PAD_WIDTH_MM / 10.0) / 2.0;
    (per_cm2 * half_pad_cm2).round() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_test_support::statistics::{mean, standard_error};

    #[test]
    fn both_halves_are_full_and_no_afferent_lies_outside() {
        for seed in 0..50 {
            let positions = population(seed);
            let (upper, lower) = positions.split_at(238);
            assert_eq!(lower.len(), 68);
            assert!(upper.iter().all(|at| at.y_mm >= 0.0) && lower.iter().all(|at| at.y_mm <= 0.0));
            let radius = |at: &Position| (at.x_mm / 9.0).hypot(at.y_mm / 12.0);
            assert!(positions.iter().all(|at| radius(at) < 1.0 + 1e-12));
        }
    }

    /// In a half ellipse of half-axes a, b: E x = 0, E x² = a²/4, E |y| = 4b/3π, E y² = b²/4, and a quarter of the
    /// area within half the radius.
    #[test]
    fn positions_are_uniform_over_each_half() {
        let all: Vec<Position> = (100..300).flat_map(population).collect();
        for upper in [true, false] {
            let half: Vec<_> = all.iter().filter(|at| (at.y_mm >= 0.0) == upper).collect();
            let check = |name, expected: f64, f: &dyn Fn(f64, f64) -> f64| {
                let values: Vec<_> = half.iter().map(|at| f(at.x_mm / 9.0, at.y_mm.abs() / 12.0)).collect();
                let mean = mean(&values);
                assert!((mean - expected).abs() < 4.0 * standard_error(&values), "{name}: {mean}");
            };
            check("x", 0.0, &|x, _| x);
            check("xx", 0.25, &|x, _| x * x);
            check("y", 4.0 / (3.0 * PI), &|_, y| y);
            check("yy", 0.25, &|_, y| y * y);
            check("xy", 0.0, &|x, y| x * y);
            check("within half", 0.25, &|x, y| f64::from(x * x + y * y < 0.25));
        }
    }

    /// Computed by a second implementation of ChaCha8, in another language.
    #[test]
    fn golden_positions_never_change() {
        for (seed, number, x_mm, y_mm) in [
            (0, 0, 0.749_291_556_860_497_3, 3.037_859_466_720_551_6),
            (0, 238, -3.860_789_286_448_257, -10.439_915_542_981_549),
            (1, 0, 0.575_073_311_842_175_1, 2.625_211_207_446_099),
        ] {
            assert_eq!(population(seed)[number], Position { x_mm, y_mm });
        }
    }
}
