//! The error of an answer against the exact one.
//!
//! Spikes of each afferent are matched in order, one to one, at most [`MATCH_S`] apart. Rates are compared by spike
//! counts: a late spike changes them only if it falls beyond the end.
//!
//! Invariant: an answer does not differ from itself.

use meissner_design::{Partition, YARDSTICK, shipped};
use meissner_skin::{Answer, Scene};
use serde::Serialize;

/// The largest distance of matched spikes, s: the model's refractory time.
pub const MATCH_S: f64 = 0.001;

/// Matches the spikes of two trains in order, one to one, as many as possible. Returns the number of pairs and the sum of
/// their distances, s.
#[must_use]
pub fn matching(expected: &[f64], found: &[f64]) -> (u64, f64) {
    let (mut expected, mut found) = (expected.iter().peekable(), found.iter().peekable());
    let (mut count, mut sum_s) = (0, 0.0);
    while let (Some(&&a), Some(&&b)) = (expected.peek(), found.peek()) {
        if (a - b).abs() <= MATCH_S {
            (count, sum_s) = (count + 1, sum_s + (a - b).abs());
            expected.next();
            found.next();
        } else if a < b {
            expected.next();
        } else {
            found.next();
        }
    }
    (count, sum_s)
}

/// The exact answer to a scene, with which others are compared.
#[derive(Debug)]
pub(super) struct Reference<'s> {
    scene: &'s Scene,
    answer: Answer,
    partition: Partition,
}

/// The error of an answer. A figure without a meaning is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Difference {
    /// The share of the exact method's spikes that have a partner within [`MATCH_S`].
    pub spikes_matched_share: Option<f64>,
    /// The mean distance of these pairs, µs.
    pub mean_error_us: Option<f64>,
    /// The difference in rate, impulses/s RMS over afferents.
    pub rate_rms_hz: Option<f64>,
    /// The excess of spikes, as a share of the exact method's.
    pub rate_bias: Option<f64>,
    /// The difference in contrast, impulses/s.
    pub cost_error_hz: Option<f64>,
}

impl<'s> Reference<'s> {
    /// `answer` is the exact one, with its spikes. The contrast is that on the yardstick.
    pub(super) fn new(scene: &'s Scene, answer: Answer) -> Self {
        let target = shipped(YARDSTICK).expect("the yardstick is shipped");
        let partition = Partition::of(&target.frames()[0].shape, target.reach_mm(), scene.afferents());
        Self { scene, answer, partition }
    }

    pub(super) const fn answer(&self) -> &Answer {
        &self.answer
    }

    pub(super) fn spikes(&self) -> u64 {
        self.answer.counts.iter().sum()
    }

    pub(super) fn cost_hz(&self) -> Option<f64> {
        self.partition.cost_hz(&self.answer.rates_hz(self.scene))
    }

    pub(super) fn difference(&self, answer: &Answer) -> Difference {
        let (matched, sum_s) = trains(&self.answer)
            .iter()
            .zip(trains(answer))
            .map(|(expected, found)| matching(expected, found))
            .fold((0, 0.0), |(all, sum_s), (count, s)| (all + count, sum_s + s));
        let (exact, found) = (self.answer.rates_hz(self.scene), answer.rates_hz(self.scene));
        let squares: f64 = exact.iter().zip(&found).map(|(exact, found)| (found - exact).powi(2)).sum();
        let (spikes, of_answer) = (self.spikes(), answer.counts.iter().sum::<u64>());
        let cost_hz = self.partition.cost_hz(&found);
        Difference {
            spikes_matched_share: (spikes > 0).then(|| matched as f64 / spikes as f64),
            mean_error_us: (matched > 0).then(|| sum_s / matched as f64 * 1e6),
            rate_rms_hz: (!exact.is_empty()).then(|| (squares / exact.len() as f64).sqrt()),
            rate_bias: (spikes > 0).then(|| of_answer as f64 / spikes as f64 - 1.0),
            cost_error_hz: cost_hz.zip(self.cost_hz()).map(|(found, exact)| found - exact),
        }
    }
}

fn trains(answer: &Answer) -> &[Vec<f64>] {
    answer.spikes_s.as_deref().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec::Array;
    use meissner_skin::Skipped;
    use meissner_skin::membrane::{AfferentModel, Position, Rectify};

    fn answer(spikes_s: &[&[f64]]) -> Answer {
        Answer {
            counts: spikes_s.iter().map(|train| train.len() as u64).collect(),
            spikes_s: Some(spikes_s.iter().map(|train| train.to_vec()).collect()),
            skipped: Skipped::default(),
        }
    }

    #[test]
    fn errors_of_spikes_times_rates_and_contrast() {
        let afferents = vec![Position { x_mm: 0.0, y_mm: 0.0 }, Position { x_mm: 8.0, y_mm: 0.0 }];
        let model = AfferentModel::default_for(Rectify::Half, 0.0);
        let scene = Scene::new(Array::paper(), 0.5, 0, vec![], afferents, model).unwrap();
        let reference = Reference::new(&scene, answer(&[&[0.1, 0.2, 0.3], &[0.4]]));
        assert_eq!((reference.spikes(), reference.cost_hz()), (4, Some(4.0)));
        let same = reference.difference(reference.answer());
        let figures = [same.spikes_matched_share, same.mean_error_us, same.rate_rms_hz, same.rate_bias];
        assert_eq!((figures, same.cost_error_hz), ([Some(1.0), Some(0.0), Some(0.0), Some(0.0)], Some(0.0)));
        let other = reference.difference(&answer(&[&[0.1004, 0.2], &[]]));
        assert_eq!((other.spikes_matched_share, other.rate_bias), (Some(0.5), Some(-0.5)));
        assert!((other.mean_error_us.unwrap() - 200.0).abs() < 1e-6);
        // Both afferents lack 2 impulses/s.
        assert_eq!((other.rate_rms_hz, other.cost_error_hz), (Some(2.0), Some(0.0)));
    }

    #[test]
    fn an_empty_scene_has_no_figures() {
        let model = AfferentModel::default_for(Rectify::Half, 0.0);
        let scene = Scene::new(Array::paper(), 0.0, 0, vec![], vec![], model).unwrap();
        let reference = Reference::new(&scene, answer(&[]));
        let found = reference.difference(reference.answer());
        assert_eq!((found.spikes_matched_share, found.mean_error_us, found.rate_rms_hz), (None, None, None));
        assert_eq!((found.rate_bias, found.cost_error_hz), (None, None));
    }
}
