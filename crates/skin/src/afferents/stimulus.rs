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
use super::contact::FlatPins;
use crate::simd::LANES;
use pulp::Simd;

/// Samples that are summed at once.
pub(super) const TILE: usize = 64;
/// Vectors that are summed at once: enough to hide the latency of an addition.
const VECTORS: usize = 8;

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
        let at = afferent.at;
        let depth_mm = afferent.class.depth_mm();
        let distances = || pins.places.iter().map(|pin| at.distance_mm(*pin));
        let punch = pins.punch;
        let held = match afferent.class {
            Class::Sa1 => distances().map(|distance_mm| punch.pressure(distance_mm, depth_mm)).collect(),
            Class::Ra | Class::Pc => Vec::new(),
        };
        Self {
            moving: distances()
                .map(|distance_mm| punch.spread(distance_mm) / (depth_mm * depth_mm))
                .collect(),
            delays: distances().map(|distance_mm| punch.delay(distance_mm)).collect(),
            held,
        }
    }
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
