//! One afferent: its parameters, its place, and its receptive field.

use serde::{Deserialize, Serialize};

/// A weight below this counts as 0 (C): at the default width a pin does not reach beyond 7.46 mm.
pub const MIN_WEIGHT: f64 = 1e-10;

/// A place on the skin, in the array's axes: x across the finger, y towards the fingertip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Position {
    /// Distance from the array's middle along x, mm.
    pub x_mm: f64,
    /// Distance from the array's middle along y, mm.
    pub y_mm: f64,
}

impl Position {
    pub(crate) fn distance_mm(self, to: Self) -> f64 {
        let (x, y) = (self.x_mm - to.x_mm, self.y_mm - to.y_mm);
        (x * x + y * y).sqrt()
    }
}

/// The part of the skin's velocity that depolarises an afferent.
///
/// The paper does not say which. Half is the default (C). Half and full rectification reproduce the paper's Fig. 4, in which the
/// motors near the edge gather at 60 Hz. The equation read literally does not (29 to 63 Hz). In the model of Freeman & Johnson
/// 1982, too, only part of a cycle depolarises (L).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rectify {
    /// Indentation only, `max(u, 0)`.
    #[default]
    Half,
    /// Both directions, `|u|`.
    Full,
    /// The paper's equation read literally, `u`.
    Signed,
}

impl Rectify {
    /// The default α, per µm (C). With it an afferent under a pin fires once per cycle of a 40 Hz sine from 10 µm (zero to
    /// peak) on, without noise. That is near the thresholds recorded from RA afferents (L: Freeman & Johnson 1982).
    pub const fn default_alpha_per_um(self) -> f64 {
        match self {
            Self::Half => 0.0492,
            Self::Full => 0.0277,
            Self::Signed => 0.2016,
        }
    }
}

/// Membrane time constant, s (P).
pub const TAU_S: f64 = 0.044;
/// Refractory period, s (P).
pub const REFRACTORY_S: f64 = 0.001;
/// Hyperexcitability after a spike, s (P).
pub const HYPEREXCITABILITY_S: f64 = 0.044;
/// Hyperexcitability lowers the threshold by this right after a spike (C): the paper does not print it.
pub const HYPEREXCITABILITY_DEPTH: f64 = 0.3;
/// Width of a receptive field, mm. It follows from field areas of 5.5 mm² at 50 µm and 22.4 mm² at 500 µm of indentation
/// (L: Vega-Bermudez & Johnson 1999). Sensitivity varies over the field by varying α (P).
pub const SIGMA_MM: f64 = 1.1;
/// The threshold never falls below this, in units of the resting threshold (C).
pub const MIN_THRESHOLD: f64 = 0.05;
/// The threshold noise is clamped to this many SD (C).
pub const NOISE_LIMIT_SD: f64 = 8.0;
/// SD of the threshold noise of a population (P). One random number per interval (C): one per time step would make the result
/// depend on the step.
pub const POPULATION_NOISE_SD: f64 = 0.05;

/// The parameters of an RA afferent: an integrate-and-fire membrane whose resting threshold is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AfferentModel {
    /// The rectification of the input.
    pub rectify: Rectify,
    /// α: depolarisation per µm of skin displacement.
    pub alpha_per_um: f64,
    /// τ: time constant of the membrane, s.
    pub tau_s: f64,
    /// The shortest time between two spikes, s.
    pub refractory_s: f64,
    /// The time after a spike in which the threshold is lowered, s.
    pub hyperexcitability_s: f64,
    /// The lowering of the threshold right after a spike, which fades linearly.
    pub hyperexcitability_depth: f64,
    /// σ: width of the receptive field, mm.
    pub sigma_mm: f64,
    /// SD of the threshold, drawn once per inter-spike interval.
    pub noise_sd: f64,
}

impl AfferentModel {
    /// The defaults for a rectification, with this threshold noise (0, or [`POPULATION_NOISE_SD`]).
    pub const fn default_for(rectify: Rectify, noise_sd: f64) -> Self {
        Self {
            rectify,
            alpha_per_um: rectify.default_alpha_per_um(),
            tau_s: TAU_S,
            refractory_s: REFRACTORY_S,
            hyperexcitability_s: HYPEREXCITABILITY_S,
            hyperexcitability_depth: HYPEREXCITABILITY_DEPTH,
            sigma_mm: SIGMA_MM,
            noise_sd,
        }
    }
}

/// Beyond this exponent a weight is certainly below [`MIN_WEIGHT`], whose logarithm is -23.03.
const MAX_EXPONENT: f64 = 24.0;

/// The weight of a motor's velocity for an afferent, `exp(-d²/2σ²)` with the distance d to its pin; exactly 0 below [`MIN_WEIGHT`].
/// It uses `libm`'s exponential, so that all machines agree.
pub fn weight(at: Position, [x_mm, y_mm]: [f64; 2], sigma_mm: f64) -> f64 {
    let (dx, dy) = (at.x_mm - x_mm, at.y_mm - y_mm);
    let exponent = (dx * dx + dy * dy) / (2.0 * sigma_mm * sigma_mm);
    // Most pins are out of reach of most afferents: skip the exponential.
    if exponent > MAX_EXPONENT {
        return 0.0;
    }
    let weight = libm::exp(-exponent);
    if weight < MIN_WEIGHT { 0.0 } else { weight }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beyond_the_largest_exponent_every_weight_is_zero() {
        assert!(libm::exp(-MAX_EXPONENT) < MIN_WEIGHT);
    }

    #[test]
    fn a_weight_is_one_under_the_pin_less_beside_it_and_zero_far_away() {
        let pin_mm @ [x_mm, y_mm] = [-1.45, 1.45];
        let at = |right_mm: f64, up_mm: f64| {
            weight(Position { x_mm: x_mm + right_mm, y_mm: y_mm + up_mm }, pin_mm, SIGMA_MM)
        };
        assert_eq!(at(0.0, 0.0), 1.0);
        assert!((at(SIGMA_MM, 0.0) - (-0.5_f64).exp()).abs() < 1e-12);
        // A 3-4-5 triangle: only the distance counts.
        assert!((at(3.0, -4.0) - at(0.0, 5.0)).abs() < 1e-12);
        assert!((at(3.0, 4.0) / (-25.0 / 2.42_f64).exp() - 1.0).abs() < 1e-9);
        assert!(at(7.46, 0.0) >= MIN_WEIGHT);
        assert_eq!(at(0.0, 7.47), 0.0);
    }

    #[test]
    fn the_defaults_differ_in_alpha_alone() {
        let half = AfferentModel::default_for(Rectify::Half, 0.0);
        assert_eq!((half.alpha_per_um, half.tau_s, half.sigma_mm), (0.0492, 0.044, 1.1));
        for (rectify, alpha_per_um) in [(Rectify::Full, 0.0277), (Rectify::Signed, 0.2016)] {
            assert_eq!(
                AfferentModel::default_for(rectify, 0.0),
                AfferentModel { rectify, alpha_per_um, ..half }
            );
        }
    }
}
