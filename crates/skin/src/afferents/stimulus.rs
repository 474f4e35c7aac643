//! Computes the stimuli of afferents from the loads of pins.
//!
//! The dynamic stimulus of an afferent is the sum of the rates of all loads, each with a weight by distance and depth. It travels
//! from the pin's edge at 8 m/s; delays are whole samples. The static stimulus, which only SA1 afferents have, is the pressure at
//! the afferent's depth below a flat punch (Sneddon 1946), without delay.
//!
//! [`mix`] sums one afferent's stimulus for a tile of samples: vectors run along time, because afferents differ in delays.
//! [`mix_together`] sums a stimulus without delays for all afferents of a group.
//!
//! Invariant: terms are added in the order of the pins, each with one rounding.

use super::afferent::{Afferent, Class};
use super::contact::{FlatPins, Place};
use super::{LANES, SAMPLES_PER_S};
use pulp::Simd;

/// Samples that are summed at once.
pub(super) const TILE: usize = 64;
/// Vectors that are summed at once: enough to hide the latency of an addition.
const VECTORS: usize = 8;
/// How fast a wave travels in the skin, mm/s (Saal et al. 2017).
const WAVE_MM_PER_S: f64 = 8000.0;

/// The weights of all pins at an afferent.
#[derive(Clone, Debug)]
pub(super) struct Field {
    /// Weights of the rates of the loads.
    pub(super) moving: Vec<f64>,
    /// Delay of each pin's wave, samples.
    pub(super) delays: Vec<u16>,
    /// Weights of the loads; empty for afferents without a static stimulus.
    pub(super) held: Vec<f64>,
}

impl Field {
    pub(super) fn new(afferent: &Afferent, pins: &FlatPins) -> Self {
        let at = Place::from(afferent.at);
        let depth_mm = afferent.class.depth_mm();
        let distances = || pins.places.iter().map(|pin| at.distance_mm(*pin));
        let radius_mm = pins.radius_mm;
        let held = match afferent.class {
            Class::Sa1 => distances().map(|distance_mm| pressure(distance_mm, depth_mm, radius_mm)).collect(),
            Class::Ra | Class::Pc => Vec::new(),
        };
        Self {
            moving: distances().map(|distance_mm| pins.spread(distance_mm) / (depth_mm * depth_mm)).collect(),
            delays: distances().map(|distance_mm| delay(distance_mm, radius_mm)).collect(),
            held,
        }
    }
}

/// Whole samples until a wave arrives; halves to even.
fn delay(distance_mm: f64, radius_mm: f64) -> u16 {
    let beyond_mm = (distance_mm - radius_mm).max(0.0);
    (beyond_mm / WAVE_MM_PER_S * SAMPLES_PER_S).round_ties_even() as u16
}

/// The pressure at a depth, per load, beside a flat round punch of a radius (Sneddon 1946).
fn pressure(distance_mm: f64, depth_mm: f64, radius_mm: f64) -> f64 {
    let (xi, rho) = (depth_mm / radius_mm, distance_mm / radius_mm);
    let a = rho * rho + xi * xi - 1.0;
    let r = (a * a + 4.0 * xi * xi).sqrt();
    let (theta, phi) = (libm::atan(1.0 / xi), libm::atan2(2.0 * xi, a));
    let j01 = libm::sin(phi / 2.0) / r.sqrt();
    let j02 = (1.0 + xi * xi).sqrt() * libm::sin(1.5 * phi - theta) / (r * r.sqrt());
    (j01 + xi * j02) / (2.0 * std::f64::consts::PI * radius_mm * radius_mm)
}

/// The weighted sum of columns for a tile of samples. `starts` says where in `columns` each pin's tile begins.
#[inline(always)]
pub(super) fn mix<S: Simd>(
    simd: S,
    weights: &[f64],
    starts: impl Iterator<Item = usize> + Clone,
    columns: &[f64],
    sums: &mut [f64; TILE],
) {
    let step = VECTORS * S::F64_LANES;
    for first in (0..TILE).step_by(step) {
        let zero = simd.splat_f64s(0.0);
        let mut sum = [zero; VECTORS];
        for (&weight, start) in weights.iter().zip(starts.clone()) {
            let weight = simd.splat_f64s(weight);
            let (vectors, _) = S::as_simd_f64s(&columns[start + first..start + first + step]);
            for (sum, &vector) in sum.iter_mut().zip(vectors) {
                *sum = simd.mul_add_f64s(weight, vector, *sum);
            }
        }
        S::as_mut_simd_f64s(&mut sums[first..first + step]).0.copy_from_slice(&sum);
    }
}

/// The weighted sums of columns without delays for a tile of samples, for all lanes at once, so that a column is read only once.
/// The tile begins at `start` of each column of `stride`.
#[inline(always)]
pub(super) fn mix_together<S: Simd>(
    simd: S,
    weights: &[[f64; LANES]],
    columns: &[f64],
    (start, stride): (usize, usize),
    sums: &mut [[f64; TILE]; LANES],
) {
    for first in (0..TILE).step_by(S::F64_LANES) {
        let mut sum = [simd.splat_f64s(0.0); LANES];
        for (pin, weights) in weights.iter().enumerate() {
            let from = pin * stride + start + first;
            let vector = S::as_simd_f64s(&columns[from..from + S::F64_LANES]).0[0];
            for (sum, &weight) in sum.iter_mut().zip(weights) {
                *sum = simd.mul_add_f64s(simd.splat_f64s(weight), vector, *sum);
            }
        }
        for (sums, sum) in sums.iter_mut().zip(sum) {
            S::as_mut_simd_f64s(&mut sums[first..first + S::F64_LANES]).0[0] = sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wave_travels_8_mm_in_a_millisecond_from_the_pins_edge() {
        for (distance_mm, samples) in [
            (0.0, 0),
            (0.5, 0),
            (1.29, 0),
            (1.31, 1),
            (2.1, 1),
            (2.89, 1),
            (2.91, 2),
            (8.5, 5),
            (1600.5, 1000),
        ] {
            assert_eq!(delay(distance_mm, 0.5), samples, "{distance_mm}");
        }
    }

    /// On the axis the pressure under a flat punch is P/(2πa²)·(1 + 3ξ²)/(1 + ξ²)²; far away it vanishes.
    #[test]
    fn the_pressure_on_the_axis_is_the_books() {
        for depth_mm in [0.1_f64, 0.3, 1.0, 2.0] {
            let square = (depth_mm / 0.5).powi(2);
            let expected =
                (1.0 + 3.0 * square) / (1.0 + square).powi(2) / (2.0 * std::f64::consts::PI * 0.25);
            assert!((pressure(0.0, depth_mm, 0.5) - expected).abs() < 1e-12, "{depth_mm}");
        }
        assert!(pressure(20.0, 0.3, 0.5).abs() < 1e-4 * pressure(0.0, 0.3, 0.5));
    }
}
