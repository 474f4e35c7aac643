//! The low-pass filter of a neuron's stimuli: Butterworth, third order, by the bilinear transform.
//!
//! It consists of a first-order and a second-order section, each in transposed direct form II. [`Sections`] runs the filters of
//! several afferents side by side.
//!
//! Invariant: no operation mixes lanes.

use super::SAMPLES_PER_S;
use pulp::Simd;

/// The coefficients: of the first section b and a, of the second b0 (b1 = 2 b0, b2 = b0), a1 and a2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LowPass {
    pub(super) first_b: f64,
    pub(super) first_a: f64,
    pub(super) second_b: f64,
    pub(super) second_a1: f64,
    pub(super) second_a2: f64,
}

impl LowPass {
    /// The filter with its -3 dB point at `cutoff_hz`, which is below half the sampling rate.
    pub(super) fn new(cutoff_hz: f64) -> Self {
        // Prewarped, so that the cutoff is exact.
        let k = 1.0 / libm::tan(std::f64::consts::PI * cutoff_hz / SAMPLES_PER_S);
        let second = k * k + k + 1.0;
        Self {
            first_b: 1.0 / (k + 1.0),
            first_a: (1.0 - k) / (k + 1.0),
            second_b: 1.0 / second,
            second_a1: (2.0 - 2.0 * k * k) / second,
            second_a2: (k * k - k + 1.0) / second,
        }
    }

    /// The state after a long time at `input`; the output is `input`, too.
    pub(super) fn settled(&self, input: f64) -> [f64; 3] {
        [
            input - self.first_b * input,
            input - self.second_b * input,
            self.second_b * input - self.second_a2 * input,
        ]
    }
}

/// The coefficients of a vector of filters.
pub(super) struct Sections<S: Simd> {
    pub(super) first_b: S::f64s,
    pub(super) first_minus_a: S::f64s,
    pub(super) second_b: S::f64s,
    pub(super) second_minus_a1: S::f64s,
    pub(super) second_minus_a2: S::f64s,
}

impl<S: Simd> Sections<S> {
    /// The next output.
    #[inline(always)]
    pub(super) fn next(&self, simd: S, state: &mut [S::f64s; 3], input: S::f64s) -> S::f64s {
        let scaled = simd.mul_f64s(self.first_b, input);
        let between = simd.add_f64s(scaled, state[0]);
        state[0] = simd.mul_add_f64s(self.first_minus_a, between, scaled);
        let scaled = simd.mul_f64s(self.second_b, between);
        let output = simd.add_f64s(scaled, state[1]);
        let twice = simd.add_f64s(simd.add_f64s(scaled, scaled), state[2]);
        state[1] = simd.mul_add_f64s(self.second_minus_a1, output, twice);
        state[2] = simd.mul_add_f64s(self.second_minus_a2, output, scaled);
        output
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The gain of both sections at a frequency.
    fn gain(filter: &LowPass, hz: f64) -> f64 {
        let w = std::f64::consts::TAU * hz / SAMPLES_PER_S;
        let (re, im) = (|n: f64| (n * w).cos(), |n: f64| -(n * w).sin());
        let size =
            |c: [f64; 3]| (c[0] + c[1] * re(1.0) + c[2] * re(2.0)).hypot(c[1] * im(1.0) + c[2] * im(2.0));
        let first = size([filter.first_b, filter.first_b, 0.0]) / size([1.0, filter.first_a, 0.0]);
        let b = filter.second_b;
        first * size([b, 2.0 * b, b]) / size([1.0, filter.second_a1, filter.second_a2])
    }

    #[test]
    fn the_gain_is_that_of_a_third_order_butterworth_filter() {
        for cutoff_hz in [73.6, 100.0, 179.5, 900.0] {
            let filter = LowPass::new(cutoff_hz);
            assert!((gain(&filter, 0.0) - 1.0).abs() < 1e-12);
            for hz in [10.0, 60.0, cutoff_hz, 400.0, 2000.0] {
                let warped = |hz: f64| (std::f64::consts::PI * hz / SAMPLES_PER_S).tan();
                let expected = 1.0 / (1.0 + (warped(hz) / warped(cutoff_hz)).powi(6)).sqrt();
                assert!((gain(&filter, hz) - expected).abs() < 1e-12, "{cutoff_hz} {hz}");
            }
        }
    }
}
