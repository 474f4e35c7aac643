//! An ideal observer of responses, estimated from few trials without being flattered by them.
//!
//! A response is a list of counts: spikes per afferent, or per afferent and bin of time. The observer knows how each count is
//! distributed for either stimulus, takes the counts as independent, and weighs each by its difference of means over its variance.
//! Its sensitivity is d′² = Σ Δμ²/σ² (Green & Swets 1966).
//!
//! Means of few trials differ by chance. Squared, these differences would add up over hundreds of afferents to a large d′ between a
//! stimulus and itself. So what chance adds on average is subtracted: the result is that of multiplying only differences of *different*
//! trials (cross-validation; Walther et al. 2016). Counts that are not independent, such as those of neighbouring bins, make the weighted sum vary more or less than
//! assumed: weights of one half of the trials are tried on the other half, and d′² is divided by what comes out.
//!
//! A count is a whole number: the observer's weights assume a variance of at least 1/12, that of rounding, and its sum scatters by as
//! much. Without it a count that never varies would be worth infinitely much. The bins of an afferent share the scatter of one count,
//! so reading times instead of counts adds none.
//!
//! Invariant: the estimates depend on the responses alone; those of two sets of trials of one stimulus have the mean 0.

use serde::Serialize;

/// The variance of rounding to a whole number.
const ROUNDING: f64 = 1.0 / 12.0;
/// The fewest trials: the variances have 2·8 − 2 degrees of freedom.
pub const LEAST_TRIALS: usize = 8;

/// Trials of a stimulus: each a list of counts, all lists of one length.
pub(super) type Trials = Vec<Vec<u16>>;

/// A sensitivity, estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Sensitivity {
    /// d′. Below 0 if the trials differ less than chance lets them.
    pub d_prime: f64,
    /// The standard error of d′: by leaving out one trial of either stimulus after the other (jackknife).
    pub se: f64,
}

/// How well an ideal observer of some counts tells two stimuli apart, from as many trials of each. `which` are the numbers of the
/// counts that it sees. `bins` of them belong to one afferent.
///
/// # Panics
/// If there are fewer than [`LEAST_TRIALS`], or not as many of both.
#[must_use]
pub fn sensitivity(one: &[Vec<u16>], other: &[Vec<u16>], which: &[u32], bins: usize) -> Sensitivity {
    let n = one.len();
    assert!(n >= LEAST_TRIALS && other.len() == n, "as many trials of both, at least {LEAST_TRIALS}");
    let mut distance = 0.0;
    // Without the trials of one number.
    let mut without = vec![0.0; n];
    let mut spreads_without = vec![0.0; n];
    let mut halves = Halves::new(n, bins);
    let mut values = [vec![0.0; n], vec![0.0; n]];
    for &count in which {
        for (values, trials) in values.iter_mut().zip([one, other]) {
            values
                .iter_mut()
                .zip(trials)
                .for_each(|(value, trial)| *value = f64::from(trial[count as usize]));
        }
        let [a, b] = &values;
        if a.iter().chain(b).all(|&value| value == a[0]) {
            continue;
        }
        let (of_a, of_b) = (Moments::of(a), Moments::of(b));
        let squares = of_a.squares + of_b.squares;
        distance += difference(of_a.mean - of_b.mean, squares, n);
        for (t, without) in without.iter_mut().enumerate() {
            let left = of_a.squares_without(a[t], n) + of_b.squares_without(b[t], n);
            *without += difference(of_a.mean_without(a[t], n) - of_b.mean_without(b[t], n), left, n - 1);
            spreads_without[t] = spread(left, n - 1);
        }
        halves.add(a, b, variance(squares, n), spread(squares, n), &spreads_without);
    }
    let (inflation, inflations) = halves.inflation();
    let square = distance / inflation;
    let left: Vec<f64> =
        without.iter().zip(inflations).map(|(distance, inflation)| distance / inflation).collect();
    let mean = left.iter().sum::<f64>() / n as f64;
    let scatter: f64 = left.iter().map(|square| (square - mean) * (square - mean)).sum();
    let se_square = (scatter * (n - 1) as f64 / n as f64).sqrt();
    let d_prime = square.abs().sqrt().copysign(square);
    // The error of a root; where the square is not larger than its error, that of the error's root.
    let se = if se_square > 0.0 { se_square / (2.0 * square.max(se_square).sqrt()) } else { 0.0 };
    Sensitivity { d_prime, se }
}

/// The squared difference of two means over the variance, less what chance adds to it.
fn difference(of_means: f64, squares: f64, n: usize) -> f64 {
    let variance = variance(squares, n);
    (of_means * of_means - 2.0 / n as f64 * (variance - ROUNDING)) / variance
}

/// The variance of a count, from squared deviations of 2n trials about two means. One over it has the right mean (that of an inverse
/// χ²), so the divisor is two less than the degrees of freedom.
fn variance(squares: f64, n: usize) -> f64 {
    squares / (2 * n - 4) as f64 + ROUNDING
}

/// The variance with the right mean itself.
fn spread(squares: f64, n: usize) -> f64 {
    squares / (2 * n - 2) as f64 + ROUNDING
}

struct Moments {
    mean: f64,
    /// Sum of the squared deviations from the mean.
    squares: f64,
}

impl Moments {
    fn of(values: &[f64]) -> Self {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        Self { mean, squares: values.iter().map(|value| (value - mean) * (value - mean)).sum() }
    }

    /// The mean of the other values.
    fn mean_without(&self, value: f64, n: usize) -> f64 {
        (self.mean * n as f64 - value) / (n - 1) as f64
    }

    /// The squared deviations of the other values from their own mean.
    fn squares_without(&self, value: f64, n: usize) -> f64 {
        let away = value - self.mean;
        (self.squares - away * away * n as f64 / (n - 1) as f64).max(0.0)
    }
}

/// The weighted sums of one half's trials with the other half's weights. Halves are the even and the odd trials.
struct Halves {
    /// Per stimulus and trial.
    sums: [Vec<f64>; 2],
    /// Per half whose weights they are: the variance of the sum if counts were independent, the same without each trial, and the part
    /// of rounding in it.
    assumed: [f64; 2],
    assumed_without: [Vec<f64>; 2],
    rounding: [f64; 2],
    /// Counts that share the rounding of one.
    bins: f64,
}

impl Halves {
    fn new(n: usize, bins: usize) -> Self {
        let zeros = || [vec![0.0; n], vec![0.0; n]];
        Self {
            sums: zeros(),
            assumed: [0.0; 2],
            assumed_without: zeros(),
            rounding: [0.0; 2],
            bins: bins as f64,
        }
    }

    /// Adds a count: its values, its variance for the weights, its spread, and that without each trial.
    fn add(&mut self, a: &[f64], b: &[f64], variance: f64, spread: f64, spreads_without: &[f64]) {
        let mut differences = [(0.0, 0.0); 2];
        for (t, (a, b)) in a.iter().zip(b).enumerate() {
            let (sum, count) = &mut differences[t % 2];
            (*sum, *count) = (*sum + a - b, *count + 1.0);
        }
        let weights = differences.map(|(sum, count)| sum / count / variance);
        for (sums, values) in self.sums.iter_mut().zip([a, b]) {
            for (t, (sum, value)) in sums.iter_mut().zip(values).enumerate() {
                *sum += weights[1 - t % 2] * value;
            }
        }
        for (half, weight) in weights.into_iter().enumerate() {
            let square = weight * weight;
            self.assumed[half] += square * spread;
            self.rounding[half] += square * ROUNDING / self.bins;
            let without = self.assumed_without[half].iter_mut().zip(spreads_without);
            without.for_each(|(sum, spread)| *sum += square * spread);
        }
    }

    /// The variance of the weighted sums over the assumed one; and without each trial.
    fn inflation(&self) -> (f64, Vec<f64>) {
        let n = self.sums[0].len();
        if self.assumed.iter().chain(self.assumed_without.iter().flatten()).any(|&assumed| assumed <= 0.0) {
            return (1.0, vec![1.0; n]);
        }
        // Per half of the trials: squared deviations of the sums from the mean of their half and stimulus.
        let mut squares = vec![0.0; n];
        for half in 0..2 {
            for sums in &self.sums {
                let own: Vec<f64> = sums.iter().skip(half).step_by(2).copied().collect();
                let mean = Moments::of(&own).mean;
                let freedom = (own.len() - 1) as f64 / own.len() as f64;
                for (t, sum) in sums.iter().enumerate().skip(half).step_by(2) {
                    let deviation = (sum - mean) * (sum - mean) / freedom;
                    squares[t] += 0.5 * (deviation + self.rounding[1 - half]);
                }
            }
        }
        let mean = |left_out: Option<usize>| {
            let others = (0..n).filter(|&t| Some(t) != left_out);
            let assumed =
                |half: usize| left_out.map_or(self.assumed[half], |t| self.assumed_without[half][t]);
            let assumed = [assumed(0), assumed(1)];
            let (sum, count) = others
                .fold((0.0, 0.0), |(sum, count), t| (sum + squares[t] / assumed[1 - t % 2], count + 1.0));
            sum / count
        };
        (mean(None), (0..n).map(|t| mean(Some(t))).collect())
    }
}

/// The share of correct answers of two intervals, one with each stimulus, where an observer says which came first: Φ(d′/√2). An
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
    // The d′ of the observer, by halving.
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

    fn all(trials: &Trials) -> Vec<u32> {
        (0..trials[0].len() as u32).collect()
    }

    /// Trials of independent normal counts of these means and this SD, rounded.
    fn normal(means: &[f64], sd: f64, seed: u64, n: usize) -> Trials {
        let mut normals = Normals::new(seed, 1);
        let mut trial =
            || means.iter().map(|mean| (mean + sd * normals.next()).round().max(0.0) as u16).collect();
        (0..n).map(|_| trial()).collect()
    }

    /// Poisson counts, by a product of uniforms.
    fn poisson(mean: f64, counts: usize, seed: u64) -> Trials {
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
        // Of 500 counts some differ: d' = sqrt(differing) · shift / SD.
        for (differing, shift, counts) in [(1, 12.0, 1), (20, 3.0, 500), (100, 8.0, 500)] {
            let sd: f64 = 4.0;
            let one = vec![40.0; counts];
            let mut other = one.clone();
            other[..differing].iter_mut().for_each(|mean| *mean += shift);
            // Rounding adds its variance once to the counts and once as the observer's.
            let expected = (differing as f64).sqrt() * shift / (sd * sd + 2.0 * ROUNDING).sqrt();
            let (mean, sd, se) = repeated(40, |seed| {
                let (one, other) = (normal(&one, sd, 2 * seed, N), normal(&other, sd, 2 * seed + 1, N));
                sensitivity(&one, &other, &all(&one), 1)
            });
            assert!((mean / expected - 1.0).abs() < 0.08, "{differing} of {counts}: {mean} for {expected}");
            assert!((0.6..1.7).contains(&(se / sd)), "{differing} of {counts}: se {se}, sd {sd}");
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
            sensitivity(&one, &other, &all(&one), 1)
        });
        let found = correct_of_two(mean, 1.0);
        assert!((found - expected).abs() < 0.02, "{found} for {expected}");
    }

    /// The plain estimate finds differences between a stimulus and itself; this one does not.
    #[test]
    fn few_trials_of_many_counts_do_not_flatter() {
        let means = vec![30.0; 500];
        let mut plain = 0.0;
        let (mean, sd, se) = repeated(40, |seed| {
            let (one, other) = (normal(&means, 3.0, 2 * seed, N), normal(&means, 3.0, 2 * seed + 1, N));
            sensitivity(&one, &other, &all(&one), 1)
        });
        let (one, other) = (normal(&means, 3.0, 1, N), normal(&means, 3.0, 2, N));
        for count in 0..500 {
            let mean =
                |trials: &Trials| trials.iter().map(|trial| f64::from(trial[count])).sum::<f64>() / N as f64;
            plain += (mean(&one) - mean(&other)).powi(2) / 9.0;
        }
        assert!(plain.sqrt() > 5.0, "{plain}");
        assert!(mean.abs() < 3.0 * sd / 40.0_f64.sqrt() && sd < 2.0 && se < 2.0, "{mean} {sd} {se}");
    }

    /// The same count many times says no more than once.
    #[test]
    fn counts_that_vary_together_are_not_counted_twice() {
        let copies =
            |trials: Trials| -> Trials { trials.into_iter().map(|trial| [trial[0]; 16].to_vec()).collect() };
        let pair = |seed| [normal(&[40.0], 4.0, 2 * seed, N), normal(&[48.0], 4.0, 2 * seed + 1, N)];
        let (once, ..) = repeated(60, |seed| {
            let [one, other] = pair(seed);
            sensitivity(&one, &other, &[0], 1)
        });
        let (copied, ..) = repeated(60, |seed| {
            let [one, other] = pair(seed).map(copies);
            sensitivity(&one, &other, &all(&one), 1)
        });
        assert!((copied / once - 1.0).abs() < 0.15, "{copied} {once}");
    }

    #[test]
    fn silence_and_certainty_are_finite() {
        let silent = vec![vec![0; 3]; 8];
        assert_eq!(sensitivity(&silent, &silent, &[0, 1, 2], 1), Sensitivity::default());
        let certain = vec![vec![0, 60, 5]; 8];
        let found = sensitivity(&silent, &certain, &[0, 1, 2], 1);
        let expected = ((3600.0 + 25.0) / ROUNDING).sqrt();
        assert!((found.d_prime / expected - 1.0).abs() < 1e-9 && found.se == 0.0, "{found:?}");
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
