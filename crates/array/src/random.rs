//! Keyed random numbers: each depends on its key alone.
//!
//! The key is a seed and the number's purpose, for example a motor and a tick. A number does not depend on those drawn before it:
//! leaving one out, or drawing in another order or on another thread, changes no other. ChaCha8 turns the key into bits, and
//! Box–Muller with `libm` turns the bits into a normal deviate. [`Normals`] is faster, a few nanoseconds per number: a stream per
//! afferent with the ziggurat of `rand_distr`, whose n-th number depends on seed, afferent and n. (One in a few thousand of those
//! lies in the tail, where the platform's logarithm is used.)
//!
//! Invariant: the same key always gives the same bits; the golden values in the tests check that.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

/// The standard normal deviate that belongs to `key`.
pub fn normal(key: [u64; 4]) -> f64 {
    let [radius, turns] = uniform(key);
    // In (0, 1], so that the logarithm is finite; the angle in [0, 1) turns.
    let radius = radius + f64::EPSILON / 2.0;
    (-2.0 * libm::log(radius)).sqrt() * libm::cos(std::f64::consts::TAU * turns)
}

/// Two numbers uniform in [0, 1), multiples of 2⁻⁵³, that belong to `key`. [`normal`] uses the same two for the same key: to
/// use both functions, use different keys.
pub fn uniform(key: [u64; 4]) -> [f64; 2] {
    let [first, second, ..] = words(key);
    [first, second].map(|bits| (bits >> 11) as f64 * (f64::EPSILON / 2.0))
}

/// Four words of random bits that belong to `key`, for example the seed of a faster generator. The other functions use them,
/// too: to use several, use different keys.
pub fn words(key: [u64; 4]) -> [u64; 4] {
    let mut seed = [0; 32];
    for (bytes, word) in seed.chunks_exact_mut(8).zip(key) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    let mut bits = ChaCha8Rng::from_seed(seed);
    std::array::from_fn(|_| bits.next_u64())
}

/// A stream of standard normal deviates: the n-th depends on the key and on n alone.
#[derive(Clone, Debug)]
pub struct Normals(ChaCha8Rng);

impl Normals {
    /// The stream that belongs to a seed and, for example, an afferent.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut bits = ChaCha8Rng::seed_from_u64(seed);
        bits.set_stream(stream);
        Self(bits)
    }

    /// The next number.
    #[inline(always)]
    #[expect(clippy::should_implement_trait, reason = "it never ends")]
    pub fn next(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_test_support::statistics::{mean, sd};

    /// Computed by a second implementation of ChaCha8, in another language.
    #[test]
    fn golden_values_never_change() {
        for (key, bits) in [
            ([0; 4], 0xbfd9_e456_6e2a_4b69_u64),
            ([1, 2, 3, 4], 0xbff4_ff87_c6d2_6b67),
            ([u64::MAX; 4], 0xbff4_601e_dd26_a168),
        ] {
            assert_eq!(normal(key).to_bits(), bits, "{key:?}: {}", normal(key));
        }
    }

    #[test]
    fn a_stream_never_changes_and_differs_by_afferent() {
        let mut stream = Normals::new(1, 2);
        let first: Vec<u64> = (0..4).map(|_| stream.next().to_bits()).collect();
        assert_eq!(first, GOLDEN_STREAM, "{first:#x?}");
        let mut other = Normals::new(1, 3);
        assert_ne!(other.next().to_bits(), first[0]);
        assert_standard(&(0..100_000).map(|_| stream.next()).collect::<Vec<_>>());
    }

    const GOLDEN_STREAM: [u64; 4] =
        [0x3ff9_9541_e215_1edb, 0x3fd5_b32d_eed8_f9bc, 0xbfe3_21f6_bc0c_c51a, 0x3fa7_84dc_4d81_52b7];

    /// Mean 0 and variance 1, each within four standard errors.
    fn assert_standard(draws: &[f64]) {
        let (n, mean, variance) = (draws.len() as f64, mean(draws), sd(draws).powi(2));
        assert!(mean.abs() < 4.0 / n.sqrt(), "{mean}");
        assert!((variance - 1.0).abs() < 4.0 * (2.0 / n).sqrt(), "{variance}");
    }

    /// By the same second implementation.
    #[test]
    fn golden_uniform_values_never_change() {
        for (key, bits) in [
            ([0; 4], [0x3fea_c80b_f125_fde0_u64, 0x3fe4_34a1_23fd_170b]),
            ([1, 2, 3, 4], [0x3fb0_fbf7_e8ae_2430, 0x3fd6_18b0_1fea_1f4c]),
            ([u64::MAX; 4], [0x3fd1_559f_9352_4868, 0x3fd9_3e19_e55e_980c]),
        ] {
            assert_eq!(uniform(key).map(f64::to_bits), bits, "{key:?}: {:?}", uniform(key));
        }
    }
}
