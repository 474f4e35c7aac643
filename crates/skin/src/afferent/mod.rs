//! The fingertip: where its RA receptors lie, what they feel of each pin, and what they are made of.
//!
//! An afferent's receptive field is a Gaussian of the distance between receptor and pin. The pad is an ellipse
//! on the middle of the array, denser in receptors towards the fingertip. There are no skin mechanics here and
//! no SA or PC afferents; both are known to be missing.
//!
//! Invariant: a position's weights depend on nothing but the position and the field's width.

mod population;

pub use population::{LOWER_PER_CM2, PAD_LENGTH_MM, PAD_WIDTH_MM, UPPER_PER_CM2, population};

use meissner_array::geometry;
use serde::{Deserialize, Serialize};

// Where the numbers come from: (P) is the paper, Gwak, Park & Kim; (L) other literature; (C) our own choice.

/// A weight below this counts as 0: beyond 7.46 mm at the default width a pin is not felt.
pub const LEAST_WEIGHT: f64 = 1e-10;

/// A place on the skin; the array's axes: x across the finger, y towards the fingertip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Position {
    /// From the array's middle.
    pub x_mm: f64,
    /// From the array's middle.
    pub y_mm: f64,
}

/// Which part of the skin's velocity depolarises a receptor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rectify {
    /// Indentation only, `max(u, 0)`.
    #[default]
    Half,
    /// Both ways, `|u|`.
    Full,
    /// The paper's equation read literally, `u`.
    Signed,
}

impl Rectify {
    /// The α at which a receptor under a pin fires once per cycle from 10 µm (zero to peak) of a 40 Hz sine on,
    /// without noise: near the thresholds recorded of RA afferents (L). The three figures are computed by us.
    #[must_use]
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
/// By how much it lowers the threshold at first (C): the paper does not print it.
pub const HYPEREXCITABILITY_DEPTH: f64 = 0.3;
/// Width of a receptive field, mm (L): from field areas of 5.5 mm² at 50 µm and 22.4 mm² at 500 µm of indentation
/// (Vega-Bermudez & Johnson 1999). That sensitivity varies over the field through α is the paper's.
pub const SIGMA_MM: f64 = 1.1;
/// The threshold never falls below this, in units of the resting one: our choice.
pub const LEAST_THRESHOLD: f64 = 0.05;
/// Draws of the threshold noise are cut at so many SD: our choice.
pub const NOISE_LIMIT_SD: f64 = 8.0;
/// SD of the threshold noise of a population (P). That it is drawn once per interval is (C): a draw per time
/// step would make the answer depend on the step.
pub const POPULATION_NOISE_SD: f64 = 0.05;

/// The RA mechanoreceptor's parameters: an integrate-and-fire membrane whose resting threshold is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaModel {
    /// What the input is rectified to.
    pub rectify: Rectify,
    /// Depolarisation per µm of skin displacement.
    pub alpha_per_um: f64,
    /// Time constant of the membrane.
    pub tau_s: f64,
    /// No spike earlier than this after a spike.
    pub refractory_s: f64,
    /// For how long after a spike the threshold is lowered.
    pub hyperexcitability_s: f64,
    /// By how much, right after the spike.
    pub hyperexcitability_depth: f64,
    /// Width of the receptive field.
    pub sigma_mm: f64,
    /// SD of the threshold, drawn once per inter-spike interval.
    pub noise_sd: f64,
}

impl RaModel {
    /// The default receptor of a kind, with this much threshold noise (0, or [`POPULATION_NOISE_SD`]).
    #[must_use]
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

/// The exponent beyond which a weight is below [`LEAST_WEIGHT`] for certain: above its logarithm, 23.03.
const FARTHEST: f64 = 24.0;

/// How much of a motor's velocity a receptor feels: `exp(-d²/2σ²)` of its distance d to the pin; below
/// [`LEAST_WEIGHT`] exactly 0. `libm`'s exponential, because two machines must agree.
#[must_use]
pub fn weight(receptor: Position, motor: u8, sigma_mm: f64) -> f64 {
    let [x_mm, y_mm] = geometry::position_mm(motor);
    let (dx, dy) = (receptor.x_mm - x_mm, receptor.y_mm - y_mm);
    let exponent = (dx * dx + dy * dy) / (2.0 * sigma_mm * sigma_mm);
    // Most pins are out of reach of most receptors: that needs no exponential.
    if exponent > FARTHEST {
        return 0.0;
    }
    let weight = libm::exp(-exponent);
    if weight < LEAST_WEIGHT { 0.0 } else { weight }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beyond_the_farthest_nothing_is_felt() {
        assert!(libm::exp(-FARTHEST) < LEAST_WEIGHT);
    }

    #[test]
    fn a_pin_is_felt_fully_under_it_less_beside_it_and_not_far_away() {
        let [x_mm, y_mm] = geometry::position_mm(9);
        let at = |right_mm: f64, up_mm: f64| {
            weight(Position { x_mm: x_mm + right_mm, y_mm: y_mm + up_mm }, 9, SIGMA_MM)
        };
        assert_eq!(at(0.0, 0.0), 1.0);
        assert!((at(SIGMA_MM, 0.0) - (-0.5_f64).exp()).abs() < 1e-12);
        // 3-4-5: only the distance counts.
        assert!((at(3.0, -4.0) - at(0.0, 5.0)).abs() < 1e-12);
        assert!((at(3.0, 4.0) / (-25.0 / 2.42_f64).exp() - 1.0).abs() < 1e-9);
        assert!(at(7.46, 0.0) >= LEAST_WEIGHT);
        assert_eq!(at(0.0, 7.47), 0.0);
    }

    #[test]
    fn far_and_narrow_are_zero_and_wide_is_one() {
        let far = Position { x_mm: 1e6, y_mm: -1e6 };
        assert_eq!(weight(far, 0, SIGMA_MM), 0.0);
        assert_eq!(weight(Position { x_mm: 0.0, y_mm: 0.0 }, 0, 1e-3), 0.0);
        assert!(weight(Position { x_mm: 0.0, y_mm: 0.0 }, 0, 1e6) > 0.999_999);
    }

    #[test]
    fn the_default_receptors_differ_in_alpha_alone() {
        let half = RaModel::default_for(Rectify::Half, 0.0);
        assert_eq!((half.alpha_per_um, half.tau_s, half.sigma_mm), (0.0492, 0.044, 1.1));
        for (rectify, alpha_per_um) in [(Rectify::Full, 0.0277), (Rectify::Signed, 0.2016)] {
            assert_eq!(RaModel::default_for(rectify, 0.0), RaModel { rectify, alpha_per_um, ..half });
        }
    }
}
