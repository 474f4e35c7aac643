//! Observers of responses, whose sensitivity is estimated from few trials without bias.
//!
//! A response is a list of counts: spikes per afferent, or per afferent and bin of time. An observer weighs each count by its
//! difference of means over its variance, and compares the sums. It learns the weights from three quarters of the trials and
//! applies them to the last quarter, four times in turn (cross-validation; Walther et al. 2016). So chance differences in one part
//! add nothing in another: a stimulus compared with itself has d′ = 0 on average, however many counts there are.
//!
//! - [`independent`]: the ideal observer of independent counts, d′² = Σ Δμ²/σ² (Green & Swets 1966). The noise of different
//!   afferents is independent in both models. The mean difference of the sums estimates this d′² without bias.
//! - [`linear`]: the mean difference of the sums over their standard deviation. It is valid for counts that depend on each other,
//!   such as neighbouring bins. Weights from few trials are poor, so it is a lower bound.
//!
//! A count is a whole number, so both observers add the variance of rounding, 1/12, to every count. Without it a count that never
//! varies would have an infinite weight.
//!
//! Invariant: the estimates depend on the responses alone.

use serde::Serialize;

/// The variance of rounding to a whole number.
const ROUNDING: f64 = 1.0 / 12.0;
/// Parts of the trials.
const FOLDS: usize = 4;
/// Groups of trials that are left out in turn for a standard error (jackknife).
const GROUPS: usize = 8;
/// The fewest trials: two in each part.
pub const LEAST_TRIALS: usize = 2 * FOLDS;

/// Trials of a stimulus: each a list of counts, all lists of one length.
pub(super) type Trials<T> = Vec<Vec<T>>;

/// A sensitivity, estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Sensitivity {
    /// d′. It is below 0 if the trials differ less than expected by chance.
    pub d_prime: f64,
    /// The standard error of d′.
    pub se: f64,
}

/// The sensitivity of the ideal observer of some independent counts, from the same number of trials of each stimulus. `which` lists
/// the counts to use.
///
/// # Panics
/// If there are fewer than [`LEAST_TRIALS`], or if the stimuli have different numbers of trials.
pub(super) fn independent<T: Copy + Into<f64>>(
    one: &[Vec<T>],
    other: &[Vec<T>],
    which: &[u32],
) -> Sensitivity {
    let square = |left_out: Option<usize>| {
        let Tried { sums: [a, b], .. } = Tried::of(one, other, which, left_out);
        a.iter().zip(&b).map(|(a, b)| a - b).sum::<f64>() / a.len() as f64
    };
    let groups: Vec<f64> = (0..GROUPS).map(|group| square(Some(group))).collect();
    let square = square(None);
    let mean = groups.iter().sum::<f64>() / GROUPS as f64;
    let scatter: f64 = groups.iter().map(|of| (of - mean) * (of - mean)).sum();
    let se_square = (scatter * (GROUPS - 1) as f64 / GROUPS as f64).sqrt();
    // The error of a square root. Where d′² is smaller than its error, the error is that at d′² = its error.
    let se = if se_square > 0.0 { se_square / (2.0 * square.max(se_square).sqrt()) } else { 0.0 };
    Sensitivity { d_prime: square.abs().sqrt().copysign(square), se }
}

/// The sensitivity of an observer that has learned its weights from these trials, as for [`independent`]. The counts may depend on each
/// other.
///
/// # Panics
/// As for [`independent`].
pub(super) fn linear<T: Copy + Into<f64>>(one: &[Vec<T>], other: &[Vec<T>], which: &[u32]) -> Sensitivity {
    let Tried { sums, rounding } = Tried::of(one, other, which, None);
    let n = sums[0].len();
    let (mut difference, mut squares) = (0.0, 0.0);
    for fold in 0..FOLDS {
        let means = sums.each_ref().map(|sums| {
            let own = || sums.iter().skip(fold).step_by(FOLDS);
            let mean = own().sum::<f64>() / own().count() as f64;
            squares += own().map(|sum| (sum - mean) * (sum - mean)).sum::<f64>();
            mean
        });
        difference += (means[0] - means[1]) / FOLDS as f64;
    }
    let freedom = (2 * n - 2 * FOLDS) as f64;
    let sd = (squares / freedom + rounding).sqrt();
    if sd == 0.0 {
        return Sensitivity::default();
    }
    let d_prime = difference / sd;
    Sensitivity { d_prime, se: (2.0 / n as f64 + d_prime * d_prime / (2.0 * freedom)).sqrt() }
}

/// The weighted sum of each trial, with weights learned from the other parts.
struct Tried {
    /// Per stimulus and trial.
    sums: [Vec<f64>; 2],
    /// The variance of rounding in a sum, mean over the parts.
    rounding: f64,
}

impl Tried {
    /// Computes the sums, without the trials of the group `left_out`, if there is one.
    fn of<T: Copy + Into<f64>>(
        one: &[Vec<T>],
        other: &[Vec<T>],
        which: &[u32],
        left_out: Option<usize>,
    ) -> Self {
        let n = one.len();
        assert!(n >= LEAST_TRIALS && other.len() == n, "as many trials of both, at least {LEAST_TRIALS}");
        let kept: Vec<usize> = (0..n).filter(|t| Some(t % GROUPS) != left_out).collect();
        let mut tried = Self { sums: [vec![0.0; kept.len()], vec![0.0; kept.len()]], rounding: 0.0 };
        for &count in which {
            let values =
                [one, other].map(|trials| kept.iter().map(|&t| trials[t][count as usize].into()).collect());
            tried.add(&values);
        }
        tried
    }

    fn add(&mut self, values: &[Vec<f64>; 2]) {
        if values.iter().flatten().all(|value| *value == values[0][0]) {
            return;
        }
        for fold in 0..FOLDS {
            let learned = values.each_ref().map(|values| Moments::without(values, fold));
            let [a, b] = &learned;
            // The divisor is two less than the degrees of freedom, so that the inverse of this variance has the right mean (that of
            // an inverse χ²).
            let variance = (a.squares + b.squares) / (a.n + b.n - 4.0) + ROUNDING;
            let weight = (a.mean - b.mean) / variance;
            for (sums, values) in self.sums.iter_mut().zip(values) {
                for (sum, value) in sums.iter_mut().zip(values).skip(fold).step_by(FOLDS) {
                    *sum += weight * value;
                }
            }
            self.rounding += weight * weight * ROUNDING / FOLDS as f64;
        }
    }
}

struct Moments {
    n: f64,
    mean: f64,
    /// Sum of the squared deviations from the mean.
    squares: f64,
}

impl Moments {
    /// The statistics of all values except those of one part.
    fn without(values: &[f64], fold: usize) -> Self {
        let others = || values.iter().enumerate().filter(|(t, _)| t % FOLDS != fold).map(|(_, value)| *value);
        let n = others().count() as f64;
        let mean = others().sum::<f64>() / n;
        Self { n, mean, squares: others().map(|value| (value - mean) * (value - mean)).sum() }
    }
}

/// The share of correct answers if each of two intervals has one stimulus and an observer says which came first: Φ(d′/√2). An
/// observer of efficiency η has the sensitivity √η·d′ (Tanner & Birdsall 1958).
#[must_use]
pub fn correct_of_two(d_prime: f64, efficiency: f64) -> f64 {
    // Φ(x) = erfc(−x/√2)/2
    libm::erfc(-d_prime * efficiency.sqrt() / 2.0) / 2.0
}

/// The efficiency at which an observer of this sensitivity has a share of correct answers, above 0.5 and below 1; none if the
/// sensitivity is not above 0.
#[must_use]
pub fn efficiency(d_prime: f64, correct: f64) -> Option<f64> {
    if d_prime <= 0.0 || !(correct > 0.5 && correct < 1.0) {
        return None;
    }
    // The d′ of the observer, by bisection.
    let (mut low, mut high) = (0.0, 20.0);
    for _ in 0..100 {
        let middle = f64::midpoint(low, high);
        if correct_of_two(middle, 1.0) < correct { low = middle } else { high = middle }
    }
    Some(low * low / (d_prime * d_prime))
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::random::Normals;

    const N: usize = 24;

    fn all(trials: &Trials<u16>) -> Vec<u32> {
        (0..trials[0].len() as u32).collect()
    }

    /// Trials of independent normal counts of these means and this SD, rounded.
    fn normal(means: &[f64], sd: f64, seed: u64, n: usize) -> Trials<u16> {
        let mut normals = Normals::new(seed, 1);
        let mut trial =
            || means.iter().map(|mean| (mean + sd * normals.next()).round().max(0.0) as u16).collect();
        (0..n).map(|_| trial()).collect()
    }

    /// Poisson counts, by a product of uniforms.
    fn poisson(mean: f64, counts: usize, seed: u64) -> Trials<u16> {
        let mut number = 0;
        let mut uniform = || {
            number += 1;
            meissner_array::random::uniform([seed, number, 0, 99])[0]
        };
        let mut count = || {
            let (mut product, mut count) = (uniform(), 0);
            while product > libm::exp(-mean) {
                product *= uniform();
                count += 1;
            }
            count
        };
        (0..N).map(|_| (0..counts).map(|_| count()).collect()).collect()
    }

    /// Means and SD of independent repetitions: estimate, and the stated standard error.
    fn repeated(times: u64, of: impl Fn(u64) -> Sensitivity) -> (f64, f64, f64) {
        let found: Vec<Sensitivity> = (0..times).map(of).collect();
        let n = times as f64;
        let mean = found.iter().map(|of| of.d_prime).sum::<f64>() / n;
        let sd = (found.iter().map(|of| (of.d_prime - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        (mean, sd, found.iter().map(|of| of.se).sum::<f64>() / n)
    }

    #[test]
    fn normal_counts_give_the_sensitivity_in_closed_form() {
        // Some of the counts differ: d' = sqrt(differing) · shift / SD.
        for (differing, shift, counts) in [(1, 12.0, 1), (20, 3.0, 500), (100, 8.0, 500)] {
            let sd: f64 = 4.0;
            let one = vec![40.0; counts];
            let mut other = one.clone();
            other[..differing].iter_mut().for_each(|mean| *mean += shift);
            // The variance of rounding counts twice: the counts are rounded, and the observer adds it.
            let expected = (differing as f64).sqrt() * shift / (sd * sd + 2.0 * ROUNDING).sqrt();
            let (mean, sd, se) = repeated(40, |seed| {
                let (one, other) = (normal(&one, sd, 2 * seed, N), normal(&other, sd, 2 * seed + 1, N));
                independent(&one, &other, &all(&one))
            });
            assert!((mean / expected - 1.0).abs() < 0.08, "{differing} of {counts}: {mean} for {expected}");
            assert!((0.5..2.0).contains(&(se / sd)), "{differing} of {counts}: se {se}, sd {sd}");
        }
    }

    #[test]
    fn poisson_counts_give_the_share_of_correct_answers_in_closed_form() {
        let (low, high, counts) = (16.0, 20.0, 4);
        // The sum of four decides: P(more) + P(equal)/2 of two Poisson sums.
        let probabilities = |mean: f64| {
            let mut of = vec![libm::exp(-mean)];
            (1..400).for_each(|k| of.push(of[k - 1] * mean / k as f64));
            of
        };
        let [few, many] = [low, high].map(|mean| probabilities(mean * counts as f64));
        let mut expected = 0.0;
        for (k, p) in many.iter().enumerate() {
            expected += p * (few[..k].iter().sum::<f64>() + 0.5 * few[k]);
        }
        let (mean, ..) = repeated(60, |seed| {
            let (one, other) = (poisson(low, counts, 2 * seed), poisson(high, counts, 2 * seed + 1));
            independent(&one, &other, &all(&one))
        });
        let found = correct_of_two(mean, 1.0);
        assert!((found - expected).abs() < 0.02, "{found} for {expected}");
    }

    /// No observer finds a difference between a stimulus and itself, even with few trials and counts that are mostly 0.
    #[test]
    fn few_trials_of_many_counts_do_not_flatter() {
        let sparse = |share: f64, seed, n| -> Trials<u16> {
            let trial =
                |t: u64| (0..600).map(move |at| meissner_array::random::uniform([seed, t, at, 98])[0]);
            (0..n).map(|t| trial(t).map(|found| u16::from(found < share)).collect()).collect()
        };
        let pair = |kind: usize, seed: u64, n: usize| {
            [2 * seed, 2 * seed + 1].map(|seed| match kind {
                0 => normal(&[30.0; 500], 3.0, seed, n),
                1 => sparse(0.05, seed, n as u64),
                _ => sparse(0.2, seed, n as u64),
            })
        };
        for kind in 0..3 {
            for n in [LEAST_TRIALS, 24] {
                for observer in [independent::<u16>, linear::<u16>] {
                    let (mean, sd, se) = repeated(40, |seed| {
                        let [one, other] = pair(kind, seed, n);
                        observer(&one, &other, &all(&one))
                    });
                    let chance = sd / 40.0_f64.sqrt();
                    assert!(mean.abs() < 3.5 * chance, "kind {kind}, {n} trials: {mean} +- {chance}");
                    assert!((0.3..3.0).contains(&(se / sd)), "kind {kind}, {n} trials: se {se}, sd {sd}");
                }
            }
        }
    }

    /// The same count many times says no more than once.
    #[test]
    fn a_linear_observer_does_not_count_correlated_counts_twice() {
        let copies = |trials: Trials<u16>| -> Trials<u16> {
            trials.into_iter().map(|trial| [trial[0]; 16].to_vec()).collect()
        };
        let pair = |seed| [normal(&[40.0], 4.0, 2 * seed, N), normal(&[48.0], 4.0, 2 * seed + 1, N)];
        let (copied, sd, se) = repeated(60, |seed| {
            let [one, other] = pair(seed).map(copies);
            linear(&one, &other, &all(&one))
        });
        // The observer assumes that rounding is independent in each copy.
        let expected = 8.0 / (16.0 + ROUNDING + ROUNDING / 16.0_f64).sqrt();
        assert!((copied / expected - 1.0).abs() < 0.1, "{copied} for {expected}");
        assert!((0.6..1.7).contains(&(se / sd)), "se {se}, sd {sd}");
    }

    /// A few informative bins among thousands of silent ones: d′ is above 0, but below the ideal observer's.
    #[test]
    fn a_linear_observer_is_a_lower_bound() {
        let ideal = 20.0_f64.sqrt() * 3.0 / (4.0_f64 * 4.0 + 2.0 * ROUNDING).sqrt();
        let (mut one, mut other) = (vec![40.0; 2000], vec![40.0; 2000]);
        one[..20].fill(43.0);
        other[20..].fill(40.0);
        let (found, ..) = repeated(10, |seed| {
            let (one, other) = (normal(&one, 4.0, 2 * seed, 100), normal(&other, 4.0, 2 * seed + 1, 100));
            linear(&one, &other, &all(&one))
        });
        assert!((0.3 * ideal..ideal).contains(&found), "{found} of {ideal}");
    }

    #[test]
    fn silence_and_certainty_are_finite() {
        let silent = vec![vec![0_u16; 3]; 8];
        let certain = vec![vec![0, 60, 5]; 8];
        let expected = ((3600.0 + 25.0) / ROUNDING).sqrt();
        for observer in [independent::<u16>, linear::<u16>] {
            assert_eq!(observer(&silent, &silent, &[0, 1, 2]), Sensitivity::default());
            let found = observer(&certain, &silent, &[0, 1, 2]);
            assert!((found.d_prime / expected - 1.0).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn shares_of_correct_answers_and_efficiencies() {
        assert!((correct_of_two(0.0, 1.0) - 0.5).abs() < 1e-12);
        // Φ(1/√2) = 0.7602
        assert!((correct_of_two(1.0, 1.0) - 0.760_25).abs() < 1e-4);
        assert!((correct_of_two(10.0, 0.01) - 0.760_25).abs() < 1e-4);
        assert!((efficiency(10.0, 0.760_25).unwrap() - 0.01).abs() < 1e-5);
        assert_eq!((efficiency(0.0, 0.7), efficiency(1.0, 0.5), efficiency(1.0, 1.0)), (None, None, None));
    }
}
