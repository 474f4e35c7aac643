//! The constants of the RA neurons in single precision, row by row.
//!
//! A [`NearRow`] has the constants that [`NearGroup`](super::near_group::NearGroup) and [`Waveform`](super::waveform::Waveform)
//! need. The neuron is that of `neuron`, except that numbers are `f32`, and that a limit far above every current is ignored.

use super::afferent::{Class, Parameters};
use super::neuron::{AFTER_SPIKE, THRESHOLD, after_spike};
use super::stimulus::TILE;
use std::sync::OnceLock;

/// The rows of RA afferents.
pub(super) const ROWS: usize = Class::Ra.rows();
/// A limit of the current above this is ignored: it lowers a current that causes a spike within a sample by less than 2 %.
const NO_LIMIT: f64 = 50.0;
/// A membrane this far below the threshold, in SD of its noise, makes no spike: there would be one in 30 000 samples.
const QUIET_SD: f64 = 4.0;

/// The constants of a row.
#[derive(Debug)]
pub(super) struct NearRow {
    pub(super) cutoff_hz: f64,
    /// Weights of the dynamic stimulus: inward, outward.
    pub(super) moving: [f32; 2],
    /// Weights of its change per sample: up, down.
    pub(super) changing: [f32; 2],
    /// One over the limit of the current, if it has one.
    pub(super) per_limit: Option<f32>,
    pub(super) noise_sd: f32,
    /// The share of the membrane that is left after a sample.
    pub(super) kept: f32,
    /// The current that follows a spike, by samples since, and zeros.
    pub(super) after_spike: [f32; AFTER_SPIKE + TILE],
    /// An afferent is silent if its membrane without noise stays below this.
    pub(super) quiet: f32,
}

/// The rows of RA afferents, in order.
pub(super) fn rows() -> &'static [NearRow; ROWS] {
    static MADE: OnceLock<[NearRow; ROWS]> = OnceLock::new();
    MADE.get_or_init(|| std::array::from_fn(NearRow::new))
}

impl NearRow {
    fn new(row: usize) -> Self {
        let p = Parameters::of_row(Class::Ra, row);
        let kept = 1.0 - 1.0 / p.leak_samples;
        let current = after_spike(p.after_spike);
        let single = |pair: [f64; 2]| pair.map(|value| value as f32);
        // The membrane sums independent deviates that fade by `kept` each sample.
        let membrane_sd = p.noise_sd / (1.0 - kept * kept).sqrt();
        let limited = p.saturation > 0.0 && p.saturation < NO_LIMIT;
        Self {
            cutoff_hz: p.cutoff_hz,
            moving: single(p.moving),
            changing: single(p.changing),
            per_limit: limited.then(|| (1.0 / p.saturation) as f32),
            noise_sd: p.noise_sd as f32,
            kept: kept as f32,
            after_spike: std::array::from_fn(|sample| current.get(sample).map_or(0.0, |&value| value as f32)),
            quiet: (THRESHOLD - QUIET_SD * membrane_sd) as f32,
        }
    }
}
