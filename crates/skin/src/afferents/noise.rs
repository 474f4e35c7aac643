//! Normal deviates for a group of afferents, one per afferent and sample.
//!
//! Each lane has its own stream: the n-th deviate depends on the seed, the afferent's number and n. ChaCha8 seeds the stream,
//! xoshiro256++ (Blackman & Vigna 2021) continues it, and Box–Muller makes two deviates of each 64 bits. The lanes are plain
//! arrays, which the compiler vectorises. The first model's ziggurat goes lane by lane and would take longer than the whole neuron.
//!
//! Invariant: the code uses only additions, products, divisions and roots with one rounding each, so all machines give the same
//! bits. The deviates are of single precision, and none is beyond 6.7 SD.

use crate::simd::LANES;
use meissner_array::random;

/// Separates these random numbers from others of the same seed.
const NOISE_WORD: u64 = 6;

/// The streams of a group.
#[derive(Clone, Debug)]
pub(super) struct Noise {
    state: [[u64; LANES]; 4],
}

impl Noise {
    /// The streams of the afferents with these numbers. A lane without an afferent has the first one's stream.
    pub(super) fn new(seed: u64, numbers: &[u32]) -> Self {
        let mut state = [[0; LANES]; 4];
        for lane in 0..LANES {
            let number = numbers.get(lane).or(numbers.first()).copied().unwrap_or(0);
            let words = random::words([seed, number.into(), 0, NOISE_WORD]);
            state.iter_mut().zip(words).for_each(|(lanes, word)| lanes[lane] = word);
        }
        Self { state }
    }

    /// The deviates of the next two samples.
    #[inline(always)]
    pub(super) fn pair(&mut self) -> [[f32; LANES]; 2] {
        let [s0, s1, s2, s3] = &mut self.state;
        let mut pair = [[0.0; LANES]; 2];
        for lane in 0..LANES {
            let bits = s0[lane].wrapping_add(s3[lane]).rotate_left(23).wrapping_add(s0[lane]);
            let shifted = s1[lane] << 17;
            s2[lane] ^= s0[lane];
            s3[lane] ^= s1[lane];
            s1[lane] ^= s2[lane];
            s0[lane] ^= s3[lane];
            s2[lane] ^= shifted;
            s3[lane] = s3[lane].rotate_left(45);
            [pair[0][lane], pair[1][lane]] = normals((bits >> 32) as u32, bits as u32);
        }
        pair
    }
}

/// Two normal deviates from two words of bits.
#[inline(always)]
fn normals(first: u32, second: u32) -> [f32; 2] {
    // In (0, 1]: its logarithm is finite.
    let share = ((first >> 1) as i32 as f32 + 0.5) * (1.0 / 2_147_483_648.0);
    let radius = (-2.0 * ln(share)).sqrt();
    // Up to an eighth of a turn in either direction; the two lowest bits choose the quarter.
    let angle = (second as i32 as f32) * (std::f32::consts::FRAC_PI_4 / 2_147_483_648.0);
    let (sin, cos) = (sin(angle), cos(angle));
    let (a, b) = if second & 1 == 0 { (cos, sin) } else { (sin, cos) };
    let radius = if second & 2 == 0 { radius } else { -radius };
    [radius * a, radius * b]
}

/// The natural logarithm of a normal positive number, within 3e-7 of its size or 1e-7.
#[inline(always)]
fn ln(x: f32) -> f32 {
    // Split x into 2^exponent and a factor between the root of a half and the root of two.
    let bits = x.to_bits().wrapping_sub(0x3f35_04f3);
    let exponent = (bits as i32 >> 23) as f32;
    let reduced = f32::from_bits((bits & 0x007f_ffff).wrapping_add(0x3f35_04f3));
    // The series of the inverse hyperbolic tangent.
    let s = (reduced - 1.0) / (reduced + 1.0);
    let z = s * s;
    let series = z.mul_add(z.mul_add(z.mul_add(2.0 / 9.0, 2.0 / 7.0), 2.0 / 5.0), 2.0 / 3.0);
    exponent.mul_add(std::f32::consts::LN_2, (z * s).mul_add(series, 2.0 * s))
}

/// The sine of an angle within an eighth of a turn, by its Taylor series.
#[inline(always)]
fn sin(x: f32) -> f32 {
    let z = x * x;
    let series = z.mul_add(z.mul_add(z.mul_add(1.0 / 362_880.0, -1.0 / 5_040.0), 1.0 / 120.0), -1.0 / 6.0);
    (x * z).mul_add(series, x)
}

/// The cosine of an angle within an eighth of a turn, by its Taylor series.
#[inline(always)]
fn cos(x: f32) -> f32 {
    let z = x * x;
    z.mul_add(z.mul_add(z.mul_add(z.mul_add(1.0 / 40_320.0, -1.0 / 720.0), 1.0 / 24.0), -0.5), 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_functions_are_those_of_the_standard_library() {
        for step in 0..=100_000_u32 {
            let x = (f64::from(step) * 2e-5 - 1.0) * std::f64::consts::FRAC_PI_4;
            assert!((f64::from(sin(x as f32)) - f64::from(x as f32).sin()).abs() < 1e-7, "{x}");
            assert!((f64::from(cos(x as f32)) - f64::from(x as f32).cos()).abs() < 1.5e-7, "{x}");
            let share = (f64::from(step) + 0.5) / 100_001.0 * if step % 2 == 0 { 1.0 } else { 1e-8 };
            let (found, right) = (f64::from(ln(share as f32)), f64::from(share as f32).ln());
            assert!((found - right).abs() < 1e-7 + 3e-7 * right.abs(), "{share}: {found}, {right}");
        }
    }

    /// Moments to the sixth, the tails, and no correlation between neighbours in time, in lane and in pair.
    #[test]
    fn deviates_are_standard_normal_and_independent() {
        let mut noise = Noise::new(7, &[0, 1, 2, 3, 4, 5, 6, 7]);
        let draws: Vec<[f32; LANES]> = (0..60_000).flat_map(|_| noise.pair()).collect();
        let n = (draws.len() * LANES) as f64;
        let moment =
            |f: &dyn Fn(f64) -> f64| draws.iter().flatten().map(|&z| f(f64::from(z))).sum::<f64>() / n;
        // Expected value and variance of each.
        let beyond_3 = 0.002_699_796;
        for (name, found, expected, variance) in [
            ("mean", moment(&|z| z), 0.0, 1.0),
            ("square", moment(&|z| z * z), 1.0, 2.0),
            ("cube", moment(&|z| z.powi(3)), 0.0, 15.0),
            ("fourth", moment(&|z| z.powi(4)), 3.0, 96.0),
            ("sixth", moment(&|z| z.powi(6)), 15.0, 10_170.0),
            ("beyond 3 SD", moment(&|z| f64::from(z.abs() > 3.0)), beyond_3, beyond_3),
        ] {
            assert!((found - expected).abs() < 4.0 * (variance / n).sqrt(), "{name}: {found}");
        }
        let correlation = |lag: usize, lanes: usize| {
            let pairs = draws.iter().zip(&draws[lag..]);
            let products =
                pairs.flat_map(|(a, b)| (0..LANES).map(move |l| f64::from(a[l] * b[(l + lanes) % LANES])));
            products.sum::<f64>() / n
        };
        for (lag, lanes) in [(1, 0), (2, 0), (3, 0), (0, 1), (0, 3), (1, 1), (100, 0)] {
            assert!(
                correlation(lag, lanes).abs() < 4.5 / n.sqrt(),
                "{lag} {lanes}: {}",
                correlation(lag, lanes)
            );
        }
    }

    #[test]
    fn a_stream_depends_on_seed_and_number_alone() {
        let all = |mut noise: Noise| -> Vec<[f32; LANES]> { (0..50).flat_map(|_| noise.pair()).collect() };
        let (a, b) = (all(Noise::new(1, &[3, 9])), all(Noise::new(1, &[9])));
        assert!(a.iter().zip(&b).all(|(a, b)| a[1] == b[0] && a[0] != b[0]));
        let other = all(Noise::new(2, &[9]));
        assert!(other.iter().zip(&b).all(|(a, b)| a[0] != b[0]));
        assert_eq!(b[0][0].to_bits(), GOLDEN, "{:#x}", b[0][0].to_bits());
    }

    const GOLDEN: u32 = 0xbf30_d9ac;
}
