//! What a search maximises: a [`Goal`], a number for the rates of one population of afferents.
//!
//! The paper maximises the contrast, a difference of two means. Most OFF afferents lie far from the shape and are silent, so the mean
//! hardly notices the few that fire between two dots. The other goals do.
//!
//! Invariant: a goal's value depends on the counts alone. The order of the afferents changes it only by rounding.

use crate::partition::Partition;
use crate::shape::Shape;
use meissner_skin::membrane::Position;
use serde::{Deserialize, Serialize};

/// What a search maximises. ON afferents are those within reach of the shape, OFF all others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Goal {
    /// Mean rate of ON minus mean rate of OFF, impulses/s: the paper's.
    Contrast,
    /// Mean rate of ON minus the root mean square of OFF, impulses/s: a few fast OFF afferents count.
    OffRms,
    /// Mean rate of ON minus twice the root mean square of OFF, impulses/s.
    #[default]
    OffRmsTwice,
    /// Mean rate of ON minus a mean of OFF in which near afferents weigh more, impulses/s: half at half a pin pitch beyond the
    /// reach, a quarter at a pitch.
    NearOff,
    /// The probability that an ON afferent fires faster than an OFF one, 0 to 1 ([`Partition::auc`]).
    Auc,
    /// The correlation of the rates with the ON set, -1 to 1.
    Correlation,
    /// How far ON afferents differ from those of the most similar rival ([`rivals`]), in standard deviations of their counts.
    Rivals,
}

/// All goals.
pub const GOALS: [Goal; 7] = [
    Goal::Contrast,
    Goal::OffRms,
    Goal::OffRmsTwice,
    Goal::NearOff,
    Goal::Auc,
    Goal::Correlation,
    Goal::Rivals,
];

/// A rival's turn, degrees.
const TURN_DEG: f64 = 15.0;

impl Goal {
    /// Its name in files and arguments.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Contrast => "contrast",
            Self::OffRms => "off-rms",
            Self::OffRmsTwice => "off-rms-twice",
            Self::NearOff => "near-off",
            Self::Auc => "auc",
            Self::Correlation => "correlation",
            Self::Rivals => "rivals",
        }
    }

    /// Whether its values are rates, impulses/s.
    pub(crate) const fn is_rate(self) -> bool {
        matches!(self, Self::Contrast | Self::OffRms | Self::OffRmsTwice | Self::NearOff)
    }

    /// The unit of its values.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Contrast | Self::OffRms | Self::OffRmsTwice | Self::NearOff => "impulses/s",
            Self::Rivals => "SD",
            Self::Auc | Self::Correlation => "",
        }
    }
}

/// Shapes that a person may confuse with this one: shifted by half a pin pitch, turned by 15° about its middle, or with one dot
/// half-way between two near dots.
#[must_use]
pub fn rivals(shape: &Shape, pitch_mm: f64) -> Vec<Shape> {
    let shift_mm = pitch_mm / 2.0;
    let mut rivals: Vec<Shape> = [[shift_mm, 0.0], [-shift_mm, 0.0], [0.0, shift_mm], [0.0, -shift_mm]]
        .map(|by_mm| shape.moved(by_mm, 0.0))
        .to_vec();
    match shape {
        Shape::Dots(dots) => {
            for [one, other] in neighbours(dots) {
                let middle = [f64::midpoint(one[0], other[0]), f64::midpoint(one[1], other[1])];
                let rest = dots.iter().filter(|dot| **dot != one && **dot != other);
                rivals.push(Shape::Dots(rest.copied().chain([middle]).collect()));
            }
        }
        Shape::Polyline(_) | Shape::Grating { .. } => {
            let [x, y] = shape.middle_mm();
            // Turned about the array's middle, then shifted back.
            rivals.extend(
                [TURN_DEG, -TURN_DEG]
                    .map(|deg| shape.moved([-x, -y], 0.0).moved([0.0; 2], deg).moved([x, y], 0.0)),
            );
        }
        Shape::Disc { .. } => {}
    }
    rivals
}

/// Pairs of dots whose distance is at most a fifth above the smallest in this shape.
#[must_use]
pub fn neighbours(dots: &[[f64; 2]]) -> Vec<[[f64; 2]; 2]> {
    let distance = |[one, other]: &[[f64; 2]; 2]| libm::hypot(one[0] - other[0], one[1] - other[1]);
    let pairs =
        dots.iter().enumerate().flat_map(|(at, one)| dots[at + 1..].iter().map(move |other| [*one, *other]));
    let mut pairs: Vec<_> = pairs.collect();
    let nearest = pairs.iter().map(distance).fold(f64::INFINITY, f64::min);
    pairs.retain(|pair| distance(pair) <= 1.2 * nearest);
    pairs
}

/// The data of a population that a goal needs.
#[derive(Clone, Debug)]
pub(crate) struct Population {
    partition: Partition,
    /// Per afferent: the weight of an OFF afferent. Only for [`Goal::NearOff`].
    nearness: Vec<f64>,
    /// Per rival and afferent: 1 if it is ON only for the shape, -1 if it is ON only for the rival. Only for [`Goal::Rivals`].
    rivals: Vec<Vec<i8>>,
}

impl Population {
    /// The population for a shape; `None` if it has no ON or no OFF afferents.
    pub(crate) fn new(
        goal: Goal,
        shape: &Shape,
        reach_mm: f64,
        pitch_mm: f64,
        afferents: &[Position],
    ) -> Option<Self> {
        let partition = Partition::of(shape, reach_mm, afferents);
        partition.has_both().then(|| {
            let half_mm = pitch_mm / 2.0;
            let nearness = |at: &Position| libm::exp2(-(shape.distance_mm(*at) - reach_mm) / half_mm);
            let nearness =
                if goal == Goal::NearOff { afferents.iter().map(nearness).collect() } else { Vec::new() };
            let rivals = if goal == Goal::Rivals { rivals(shape, pitch_mm) } else { Vec::new() };
            let differ = |rival: Shape| {
                let theirs = Partition::of(&rival, reach_mm, afferents);
                let of = |(own, their): (&bool, &bool)| i8::from(*own) - i8::from(*their);
                let signs: Vec<i8> = partition.on().iter().zip(theirs.on()).map(of).collect();
                // A rival that differs by too few afferents says nothing about this population.
                let both = [1, -1].iter().all(|sign| signs.iter().filter(|of| *of == sign).count() > 1);
                both.then_some(signs)
            };
            Self { rivals: rivals.into_iter().filter_map(differ).collect(), partition, nearness }
        })
    }

    pub(crate) const fn partition(&self) -> &Partition {
        &self.partition
    }

    /// The sums of the counts of OFF and ON afferents.
    pub(crate) fn sums(&self, counts: &[u64]) -> [u64; 2] {
        let mut sums = [0; 2];
        for (&on, count) in self.partition.on().iter().zip(counts) {
            sums[usize::from(on)] += count;
        }
        sums
    }

    /// The goal's value of these counts of `duration_s`.
    pub(crate) fn value(&self, goal: Goal, counts: &[u64], duration_s: f64) -> f64 {
        let [off, on] = self.sums(counts);
        let on_hz = on as f64 / self.partition.on_count() as f64 / duration_s;
        match goal {
            Goal::Contrast => on_hz - off as f64 / self.partition.off_count() as f64 / duration_s,
            Goal::OffRms => on_hz - self.off_rms(counts) / duration_s,
            Goal::OffRmsTwice => on_hz - 2.0 * self.off_rms(counts) / duration_s,
            Goal::NearOff => {
                let off =
                    self.partition.on().iter().zip(counts).zip(&self.nearness).filter(|((on, _), _)| !**on);
                let (sum, weights) = off.fold((0.0, 0.0), |(sum, weights), ((_, count), weight)| {
                    (sum + weight * *count as f64, weights + weight)
                });
                on_hz - sum / weights / duration_s
            }
            Goal::Auc => {
                let rates: Vec<f64> = counts.iter().map(|&count| count as f64).collect();
                self.partition.auc(&rates).unwrap_or(0.5)
            }
            Goal::Correlation => correlation(self.partition.on(), counts),
            Goal::Rivals => {
                let values = self.rivals.iter().map(|signs| separation(signs, counts));
                values.reduce(f64::min).unwrap_or(0.0)
            }
        }
    }

    /// Root mean square of the counts of OFF afferents.
    fn off_rms(&self, counts: &[u64]) -> f64 {
        let off = self.partition.on().iter().zip(counts).filter(|(on, _)| !**on);
        let squares: u64 = off.map(|(_, count)| count * count).sum();
        (squares as f64 / self.partition.off_count() as f64).sqrt()
    }
}

/// Pearson's correlation of counts with a set; 0 if all counts are equal.
pub(crate) fn correlation(set: &[bool], counts: &[u64]) -> f64 {
    // Whole numbers, so that the order does not change the sums.
    let (mut sum, mut squares, mut inside, mut members) = (0_u64, 0_u64, 0_u64, 0_u64);
    for (&is_in, &count) in set.iter().zip(counts) {
        sum += count;
        squares += count * count;
        inside += if is_in { count } else { 0 };
        members += u64::from(is_in);
    }
    let (n, members) = (counts.len() as f64, members as f64);
    let covariance = inside as f64 - members * sum as f64 / n;
    let variances = (squares as f64 - sum as f64 * sum as f64 / n) * members * (1.0 - members / n);
    if variances > 0.0 { covariance / variances.sqrt() } else { 0.0 }
}

/// The difference between the mean counts of the afferents with sign 1 and those with -1, in standard deviations.
fn separation(signs: &[i8], counts: &[u64]) -> f64 {
    let figures = |sign: i8| {
        let mut sums = (0.0, 0.0, 0.0);
        for count in signs.iter().zip(counts).filter(|(of, _)| **of == sign).map(|(_, count)| *count as f64) {
            sums = (sums.0 + 1.0, sums.1 + count, sums.2 + count * count);
        }
        let (n, sum, squares) = sums;
        (sum / n, (squares / n - (sum / n) * (sum / n)).max(0.0))
    };
    let ((own, own_variance), (their, their_variance)) = (figures(1), figures(-1));
    // Add the Poisson variance of one spike, so that two silent sets do not differ.
    (own - their) / (f64::midpoint(own_variance, their_variance) + 1.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two dots 6 mm apart, with afferents on both, between them, and far away.
    fn population(goal: Goal) -> Population {
        let places = [-3.0, 3.0, 0.0, -0.2, 9.0, -9.0, 3.1, -3.1];
        let positions = places.map(|x_mm| Position { x_mm, y_mm: 0.0 });
        let shape = Shape::Dots(vec![[-3.0, 0.0], [3.0, 0.0]]);
        Population::new(goal, &shape, 1.45, 2.9, &positions).unwrap()
    }

    const APART: [u64; 8] = [60, 60, 0, 0, 0, 0, 60, 60];
    /// The same number of OFF spikes, either between the dots or spread over all.
    const MERGED: [u64; 8] = [60, 60, 60, 60, 0, 0, 60, 60];
    const SPREAD: [u64; 8] = [60, 60, 30, 30, 30, 30, 60, 60];

    #[test]
    fn the_contrast_does_not_see_where_off_afferents_fire_and_the_others_do() {
        let value = |goal, counts: &[u64]| population(goal).value(goal, counts, 1.0);
        for goal in GOALS {
            let [apart, merged, spread] = [&APART, &MERGED, &SPREAD].map(|counts| value(goal, counts));
            assert!(apart > merged, "{goal:?}: {apart} {merged}");
            match goal {
                Goal::Contrast => assert!((merged, spread) == (30.0, 30.0)),
                _ => assert!(merged < spread, "{goal:?}: {merged} {spread}"),
            }
        }
        let off_rms = 60.0 - (2.0 * 3600.0 / 4.0_f64).sqrt();
        assert!((value(Goal::OffRms, &MERGED) - off_rms).abs() < 1e-9);
        assert!((value(Goal::Correlation, &APART) - 1.0).abs() < 1e-12);
        assert!((value(Goal::OffRmsTwice, &APART), value(Goal::Auc, &APART)) == (60.0, 1.0));
    }

    #[test]
    fn values_do_not_depend_on_the_duration_of_equal_rates() {
        let twice = MERGED.map(|count| 2 * count);
        for goal in GOALS.into_iter().filter(|goal| *goal != Goal::Rivals) {
            let population = population(goal);
            assert_eq!(population.value(goal, &MERGED, 1.0), population.value(goal, &twice, 2.0), "{goal:?}");
        }
    }

    #[test]
    fn rivals_are_shifted_turned_and_merged() {
        let two = Shape::Dots(vec![[-3.0, 0.0], [3.0, 0.0]]);
        assert!(rivals(&two, 2.9).contains(&Shape::Dots(vec![[0.0, 0.0]])));
        assert!(rivals(&two, 2.9).contains(&Shape::Dots(vec![[-1.55, 0.0], [4.45, 0.0]])));
        let edge = Shape::Polyline(vec![[1.0, 0.0], [5.0, 0.0]]);
        let turned = rivals(&edge, 2.9).into_iter().last().unwrap();
        // The rival is turned about its own middle, which stays in place.
        assert!(turned.distance_mm(Position { x_mm: 3.0, y_mm: 0.0 }) < 1e-9);
        assert!(turned.distance_mm(Position { x_mm: 5.0, y_mm: 0.0 }) > 0.4);
    }

    #[test]
    fn neighbours_are_the_nearest_pairs() {
        let letter = [[0.0, 0.0], [0.0, 2.9], [0.0, 5.8], [2.9, 5.8]];
        assert_eq!(neighbours(&letter).len(), 3);
        assert!(neighbours(&letter[..1]).is_empty());
    }

    #[test]
    fn names_are_those_of_files() {
        for goal in GOALS {
            assert_eq!(serde_json::to_value(goal).unwrap(), goal.name());
        }
    }
}
