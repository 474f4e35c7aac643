//! Computes which pattern an observer names when it must name one of a set.
//!
//! Each pair of patterns has a sensitivity d′ (`observer`). Responses to pattern i scatter by 1 about a point, in every direction,
//! and the points of two patterns lie √η·d′ apart; the observer names the nearest point. So the shares follow from the distances
//! alone; they are computed from random responses. No set of points may have exactly the estimated distances: classical scaling
//! finds the nearest possible ones (Torgerson 1952).
//!
//! Invariant: each row of a [`Confusion`] sums to 100 %.

use super::observer::{Sensitivity, independent};
use super::{Plan, Responses, sd};
use meissner_array::pattern::Pattern;
use meissner_array::random::Normals;
use meissner_skin::{Finger, FingerError};
use serde::Serialize;
use std::cmp::Ordering;

/// Responses that are drawn of each pattern on each finger.
const DRAWS: u32 = 4000;
/// The largest distance of two points: at this distance 1 response in 700 is nearer to the wrong one. The error of a larger
/// distance would move points that are near each other.
const FAR: f64 = 6.0;
/// Streams of the draws.
const FIRST_STREAM: u64 = 1 << 40;

/// The answers of an observer that names one of several patterns: means over fingers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Confusion {
    /// The patterns' names.
    pub names: Vec<String>,
    /// Row: the pattern that is played; column: the pattern that is named; per cent.
    pub percent: Vec<Vec<f64>>,
    /// Sensitivity d′ for each pair, at an efficiency of 1.
    pub d_prime: Vec<Vec<f64>>,
    /// Correct answers, per cent: the mean of the diagonal.
    pub correct_percent: f64,
    /// The standard error of that, over fingers; none with one finger.
    pub correct_percent_se: Option<f64>,
    /// The same for an observer of the total count alone: the baseline.
    pub total_correct_percent: f64,
    /// By chance, per cent.
    pub chance_percent: f64,
}

/// Names patterns by the counts of all afferents. `progress` gets the completed share.
///
/// # Errors
/// If a pattern cannot be simulated.
///
/// # Panics
/// If the plan was not checked, or if there is no pattern.
pub fn confusion(
    patterns: &[&Pattern],
    plan: &Plan,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Confusion, FingerError> {
    let n = patterns.len();
    let work = (plan.fingers.len() * n) as f64;
    let mut all = Vec::new();
    for (index, &seed) in plan.fingers.iter().enumerate() {
        let finger = Finger::new(plan.model, seed);
        let which: Vec<u32> = (0..finger.afferents().len() as u32).collect();
        let mut responses = Vec::new();
        for (number, pattern) in patterns.iter().enumerate() {
            responses.push(Responses::of(pattern, number, (&finger, seed), plan, false)?);
            progress((index * n + number + 1) as f64 / work);
        }
        let totals: Vec<_> = responses.iter().map(|of| of.totals(&which)).collect();
        let counts = pairs(n, |a, b| independent(&responses[a].counts, &responses[b].counts, &which));
        let total = pairs(n, |a, b| independent(&totals[a], &totals[b], &[0]));
        let named = [&counts, &total].map(|distances| named(distances, plan.efficiency, plan.seed ^ seed));
        all.push((counts, named));
    }
    let fingers = all.len() as f64;
    let mean = |of: &dyn Fn(usize) -> f64| (0..all.len()).map(of).sum::<f64>() / fingers;
    let table = |of: &dyn Fn(usize, usize, usize) -> f64| -> Vec<Vec<f64>> {
        (0..n).map(|row| (0..n).map(|column| mean(&|finger| of(finger, row, column))).collect()).collect()
    };
    let correct = |finger: usize, which: usize| {
        (0..n).map(|own| all[finger].1[which][own][own]).sum::<f64>() / n as f64
    };
    let correct_percent = mean(&|finger| correct(finger, 0));
    Ok(Confusion {
        names: patterns.iter().map(|pattern| pattern.name().to_owned()).collect(),
        percent: table(&|finger, row, column| all[finger].1[0][row][column]),
        d_prime: table(&|finger, row, column| all[finger].0[row][column]),
        correct_percent,
        correct_percent_se: sd((0..all.len()).map(|finger| correct(finger, 0))).map(|sd| sd / fingers.sqrt()),
        total_correct_percent: mean(&|finger| correct(finger, 1)),
        chance_percent: 100.0 / n as f64,
    })
}

/// The d′ of each pair: symmetric, 0 on the diagonal.
fn pairs(n: usize, of: impl Fn(usize, usize) -> Sensitivity) -> Vec<Vec<f64>> {
    let below: Vec<Vec<f64>> =
        (0..n).map(|row| (0..row).map(|column| of(column, row).d_prime).collect()).collect();
    let at = |row: usize, column: usize| match row.cmp(&column) {
        Ordering::Less => below[column][row],
        Ordering::Equal => 0.0,
        Ordering::Greater => below[row][column],
    };
    (0..n).map(|row| (0..n).map(|column| at(row, column)).collect()).collect()
}

/// The shares of names in per cent, for points at these distances.
fn named(distances: &[Vec<f64>], efficiency: f64, seed: u64) -> Vec<Vec<f64>> {
    let n = distances.len();
    let scaled = |a: usize, b: usize| {
        let distance = (distances[a][b] * efficiency.sqrt()).min(FAR);
        distance * distance.abs()
    };
    let points = points(n, scaled);
    let row = |played: usize| {
        let mut normals = Normals::new(seed, FIRST_STREAM + played as u64);
        let mut shares = vec![0.0; n];
        for _ in 0..DRAWS {
            let response: Vec<f64> = points[played].iter().map(|at| at + normals.next()).collect();
            let away = |point: &Vec<f64>| -> f64 {
                point.iter().zip(&response).map(|(at, found)| (at - found) * (at - found)).sum()
            };
            let away: Vec<f64> = points.iter().map(away).collect();
            let nearest = away.iter().copied().fold(f64::INFINITY, f64::min);
            // Patterns at one point are named equally often.
            let ties = away.iter().filter(|&&of| of == nearest).count() as f64;
            for (share, of) in shares.iter_mut().zip(&away) {
                *share += if *of == nearest { 100.0 / ties / f64::from(DRAWS) } else { 0.0 };
            }
        }
        shares
    };
    (0..n).map(row).collect()
}

/// Points whose squared distances come nearest to these: classical scaling. Directions with a negative eigenvalue are left out.
fn points(n: usize, square: impl Fn(usize, usize) -> f64) -> Vec<Vec<f64>> {
    let mean_of = |row: usize| (0..n).map(|column| square(row, column)).sum::<f64>() / n as f64;
    let means: Vec<f64> = (0..n).map(mean_of).collect();
    let mean = means.iter().sum::<f64>() / n as f64;
    let product = |row: usize, column: usize| (means[row] + means[column] - mean - square(row, column)) / 2.0;
    let products = (0..n).map(|row| (0..n).map(|column| product(row, column)).collect()).collect();
    let (values, vectors) = eigen(products);
    let point =
        |row: &Vec<f64>| row.iter().zip(&values).map(|(at, value)| at * value.max(0.0).sqrt()).collect();
    vectors.iter().map(point).collect()
}

/// The eigenvalues of a symmetric matrix, and its eigenvectors as columns, by Jacobi's rotations.
fn eigen(mut matrix: Vec<Vec<f64>>) -> (Vec<f64>, Vec<Vec<f64>>) {
    /// Rounds over all pairs; they converge after a few.
    const ROUNDS: usize = 50;
    let n = matrix.len();
    let mut vectors: Vec<Vec<f64>> =
        (0..n).map(|row| (0..n).map(|column| f64::from(u8::from(row == column))).collect()).collect();
    for (p, q) in (0..ROUNDS).flat_map(|_| (0..n).flat_map(move |q| (0..q).map(move |p| (p, q)))) {
        if matrix[p][q] == 0.0 {
            continue;
        }
        let half = (matrix[q][q] - matrix[p][p]) / (2.0 * matrix[p][q]);
        let tangent = half.signum() / (half.abs() + half.hypot(1.0));
        let cosine = 1.0 / tangent.hypot(1.0);
        let sine = tangent * cosine;
        let rotate = |row: &mut Vec<f64>| {
            (row[p], row[q]) = (cosine * row[p] - sine * row[q], sine * row[p] + cosine * row[q]);
        };
        matrix.iter_mut().for_each(rotate);
        let (above, below) = matrix.split_at_mut(q);
        for (a, b) in above[p].iter_mut().zip(&mut below[0]) {
            (*a, *b) = (cosine * *a - sine * *b, sine * *a + cosine * *b);
        }
        vectors.iter_mut().for_each(rotate);
    }
    ((0..n).map(|at| matrix[at][at]).collect(), vectors)
}

#[cfg(test)]
mod tests {
    use super::super::observer::correct_of_two;
    use super::*;

    #[test]
    fn points_have_the_given_distances() {
        let places: [[f64; 2]; 4] = [[0.0, 0.0], [3.0, 0.0], [0.0, 4.0], [-1.0, -2.0]];
        let square = |a: usize, b: usize| {
            (places[a][0] - places[b][0]).powi(2) + (places[a][1] - places[b][1]).powi(2)
        };
        let points = points(4, square);
        for a in 0..4 {
            for b in 0..4 {
                let found: f64 = points[a].iter().zip(&points[b]).map(|(x, y)| (x - y) * (x - y)).sum();
                assert!((found - square(a, b)).abs() < 1e-9, "{a} {b}: {found}");
            }
        }
    }

    /// Noise has made these distances impossible. The points still come near them, in any order of the patterns.
    #[test]
    fn impossible_distances_give_the_nearest_points_in_any_order() {
        let wanted = |a: usize, b: usize| -> f64 {
            match (a.min(b), a.max(b)) {
                (a, b) if a == b => 0.0,
                (0, 1) => 0.05,
                (0, 2) => 1.0,
                _ => 1.5,
            }
        };
        let mut seen = Vec::new();
        for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            let points = points(3, |a, b| wanted(order[a], order[b]).powi(2));
            let mut distances = [[0.0; 3]; 3];
            for a in 0..3 {
                for b in 0..3 {
                    let square: f64 = points[a].iter().zip(&points[b]).map(|(x, y)| (x - y) * (x - y)).sum();
                    distances[order[a]][order[b]] = square.sqrt();
                    assert!((square.sqrt() - wanted(order[a], order[b])).abs() < 0.4, "{order:?} {a} {b}");
                }
            }
            seen.push(distances);
        }
        for distances in &seen {
            let all = distances.iter().flatten().zip(seen[0].iter().flatten());
            assert!(all.into_iter().all(|(one, first)| (one - first).abs() < 1e-6), "{seen:?}");
        }
    }

    /// For two patterns d' apart the border lies half-way, so the share of correct names is Φ(d'/2).
    #[test]
    fn shares_of_two_are_those_in_closed_form() {
        for (d_prime, efficiency) in [(0.0, 1.0), (1.0, 1.0), (3.0, 1.0), (30.0, 0.01)] {
            let found = named(&[vec![0.0, d_prime], vec![d_prime, 0.0]], efficiency, 1);
            let expected = 100.0 * correct_of_two(d_prime / std::f64::consts::SQRT_2, efficiency);
            assert!((found[0][0] - expected).abs() < 3.0, "{d_prime}: {} for {expected}", found[0][0]);
            for row in &found {
                assert!((row.iter().sum::<f64>() - 100.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn equal_patterns_share_their_names_and_far_ones_do_not() {
        let far = vec![vec![0.0, 0.0, 50.0], vec![0.0, 0.0, 50.0], vec![50.0, 50.0, 0.0]];
        let found = named(&far, 1.0, 2);
        assert!((found[0][0] - 50.0).abs() < 0.5 && (found[0][1] - 50.0).abs() < 0.5, "{found:?}");
        assert!(found[2][2] > 99.5, "{found:?}");
    }
}
