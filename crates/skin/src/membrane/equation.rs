//! The membrane in closed form between breakpoints, and the threshold.
//!
//! Over a segment of length L on which the input is `v + k s`, a leaky membrane with rate r goes from P to
//! `P - P x φ1 + gain L (v φ1 + k L φ2)`, where `x = r L`, `φ2(x) = (x - 1 + e^-x) / x²`, `φ1(x) = 1 - x φ2(x)` `= (1 - e^-x) / x`.
//! In this form no terms cancel, even for the smallest x: with a time constant of 10⁶ s it becomes the polynomial without a leak.
//!
//! Time is in half ticks, input in half pulses weighted by the receptive field.
//!
//! Invariant: lengths are measured from the start of a segment, never from the start of the scene.

use crate::breakpoints::velocity_per_d;
use crate::membrane::{AfferentModel, MIN_THRESHOLD, NOISE_LIMIT_SD, Rectify};
use meissner_array::random::Normals;
use meissner_array::spec::ArraySpec;

/// An [`AfferentModel`] in the simulator's units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Membrane {
    pub(crate) rectify: Rectify,
    /// 1/τ, per half tick.
    pub(crate) rate: f64,
    /// Depolarisation per half tick by an input of one half pulse at weight 1.
    pub(crate) gain: f64,
    /// Half ticks.
    pub(crate) refractory: f64,
    /// The lowering of the threshold right after a spike.
    pub(crate) depth: f64,
    /// How long the threshold is lowered, half ticks.
    pub(crate) lowering: f64,
    /// Recovery of the threshold per half tick.
    pub(crate) recovery: f64,
    pub(crate) noise_sd: f64,
}

impl Membrane {
    pub(crate) fn of(model: &AfferentModel, array: &ArraySpec) -> Self {
        let half_ticks_per_s = array.rate().half_ticks_per_s();
        let lowered = model.hyperexcitability_s > 0.0;
        let hyperexcitability = model.hyperexcitability_s * half_ticks_per_s;
        Self {
            rectify: model.rectify,
            rate: 1.0 / (model.tau_s * half_ticks_per_s),
            gain: velocity_per_d(model.alpha_per_um, array.motor()),
            refractory: model.refractory_s * half_ticks_per_s,
            depth: if lowered { model.hyperexcitability_depth } else { 0.0 },
            lowering: hyperexcitability,
            recovery: if lowered { model.hyperexcitability_depth / hyperexcitability } else { 0.0 },
            noise_sd: model.noise_sd,
        }
    }

    /// Draws the resting threshold of the next inter-spike interval.
    #[inline(always)]
    pub(crate) fn draw(&self, noise: Option<&mut Normals>) -> f64 {
        match noise {
            Some(noise) => 1.0 + self.noise_sd * noise.next().clamp(-NOISE_LIMIT_SD, NOISE_LIMIT_SD),
            None => 1.0,
        }
    }

    /// The threshold `since` half ticks after the last spike; `resting` is 1 plus its noise.
    #[inline(always)]
    pub(crate) fn threshold(&self, resting: f64, since: f64) -> f64 {
        (resting - (self.depth - self.recovery * since).max(0.0)).max(MIN_THRESHOLD)
    }

    /// The membrane `length` after it was at `p`, under the rectified input `v + k s`. `gain` includes the scale of the
    /// weights.
    #[inline(always)]
    pub(crate) fn after(&self, p: f64, gain: f64, v: f64, k: f64, length: f64) -> f64 {
        let x = self.rate * length;
        let phi2 = phi2(x);
        let phi1 = (-x).mul_add(phi2, 1.0);
        let input = length * v.mul_add(phi1, (k * length) * phi2);
        gain.mul_add(input, p - p * (x * phi1))
    }
}

/// Up to this, φ2 is summed as a series; beyond, it is computed from `expm1`.
pub(crate) const SERIES_ENDS: f64 = 1.0;
/// Up to this, the first 7 terms of the series suffice, to 10⁻¹⁸.
pub(crate) const SHORT_SERIES_ENDS: f64 = 1.0 / 64.0;

/// The series of φ2: `(-1)^n / (n + 2)!`.
pub(crate) const SERIES: [f64; 17] = {
    let mut terms = [0.5; 17];
    let mut n = 1;
    while n < terms.len() {
        terms[n] = -terms[n - 1] / (n + 2) as f64;
        n += 1;
    }
    terms
};
/// Terms of the short series.
pub(crate) const SHORT: usize = 7;

/// `(x - 1 + e^-x) / x²`, to a few units in the last place for every x ≥ 0.
#[inline(always)]
pub(crate) fn phi2(x: f64) -> f64 {
    if x <= SHORT_SERIES_ENDS {
        // Sum in pairs, for speed: each step towards a crossing waits for this result.
        let pair = |n: usize| SERIES[n + 1].mul_add(x, SERIES[n]);
        let square = x * x;
        let tail = SERIES[6].mul_add(square, pair(4));
        tail.mul_add(square, pair(2)).mul_add(square, pair(0))
    } else if x <= SERIES_ENDS {
        SERIES.iter().rev().fold(0.0, |sum, term| sum * x + term)
    } else {
        (x + libm::expm1(-x)) / (x * x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::membrane::TAU_S;
    use meissner_array::spec::Array;
    use meissner_test_support::paper::{HALF_TICKS_PER_S, UM_PER_PULSE, WINDOW_HALF_TICKS};

    /// Computed with 400 digits.
    #[test]
    fn phi2_is_right_to_a_few_units_in_the_last_place() {
        for (x, expected) in [
            (0.0, 0.5),
            (1e-300, 0.5),
            (1e-12, 0.499_999_999_999_833_36),
            (0.001, 0.499_833_374_991_668_1),
            (0.015624999999999997, 0.497_405_974_152_830_94),
            (0.015625, 0.497_405_974_152_830_94),
            (0.015625000000000007, 0.497_405_974_152_830_94),
            (0.1, 0.483_741_803_595_957_3),
            (0.5, 0.426_122_638_850_533_7),
            (0.9999999999999999, 0.367_879_441_171_442_33),
            (1.0, 0.367_879_441_171_442_33),
            (1.0000000000000002, 0.367_879_441_171_442_3),
            (1.5, 0.321_391_182_288_191),
            (3.0, 0.227_754_118_707_540_45),
            (10.0, 0.090_000_453_999_297_62),
            (100.0, 0.0099),
            (1000.0, 0.000_999),
            (1e9, 9.999_999_99e-10),
        ] {
            let found: f64 = phi2(x);
            assert!((found - expected).abs() < 4.0 * f64::EPSILON * expected, "{x}: {found} {expected}");
        }
    }

    #[test]
    fn a_segment_cut_anywhere_gives_the_same_membrane() {
        for tau_s in [1e-4, TAU_S, 1e6] {
            let model = AfferentModel { tau_s, ..AfferentModel::default_for(Rectify::Half, 0.0) };
            let membrane = Membrane::of(&model, &Array::paper());
            let (p, v, k, length) = (0.3, 200.0, -0.3, 500.0);
            let whole = membrane.after(p, membrane.gain, v, k, length);
            for cut in [0.0, 1e-9, 3.0, 250.0, 499.0, 500.0] {
                let middle = membrane.after(p, membrane.gain, v, k, cut);
                let found = membrane.after(middle, membrane.gain, v + k * cut, k, length - cut);
                assert!((found - whole).abs() < 1e-14, "{tau_s} {cut}: {found} {whole}");
            }
        }
    }

    #[test]
    fn without_input_the_membrane_decays_and_without_leak_it_integrates() {
        let model = AfferentModel::default_for(Rectify::Half, 0.0);
        let membrane = Membrane::of(&model, &Array::paper());
        let tau = TAU_S * HALF_TICKS_PER_S;
        assert!((membrane.after(1.0, membrane.gain, 0.0, 0.0, tau) - (-1.0_f64).exp()).abs() < 1e-15);
        // 1 um of displacement is alpha.
        let endless = Membrane::of(&AfferentModel { tau_s: 1e9, ..model }, &Array::paper());
        let half_pulses = WINDOW_HALF_TICKS as f64 * 2.0 / UM_PER_PULSE / 100.0;
        let found = endless.after(0.0, endless.gain, half_pulses, 0.0, 100.0);
        assert!((found / model.alpha_per_um - 1.0).abs() < 1e-9, "{found}");
    }

    #[test]
    fn the_threshold_is_lowered_after_a_spike_and_never_below_its_least() {
        let membrane = Membrane::of(&AfferentModel::default_for(Rectify::Half, 0.0), &Array::paper());
        assert_eq!(membrane.threshold(1.0, 0.0), 0.7);
        assert!((membrane.threshold(1.0, membrane.lowering / 2.0) - 0.85).abs() < 1e-15);
        assert_eq!(membrane.threshold(1.0, membrane.lowering * 1.001), 1.0);
        assert_eq!(membrane.threshold(0.2, 0.0), MIN_THRESHOLD);
        let never = Membrane { lowering: 0.0, depth: 0.0, recovery: 0.0, ..membrane };
        assert_eq!(never.threshold(1.0, 0.0), 1.0);
    }
}
