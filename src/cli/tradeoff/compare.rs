//! The error of an answer against the exact one.
//!
//! Spikes of each afferent are matched in order, one to one, at most [`MATCH_S`] apart. Rates are compared by spike
//! counts: a late spike changes them only if it falls beyond the end.
//!
//! Invariant: an answer does not differ from itself.

use meissner_skin::{Answer, Scene};
use serde::Serialize;

/// The largest distance of matched spikes, s: the model's refractory time.
const MATCH_S: f64 = 0.001;

/// Matches the spikes of two trains in order, one to one, as many as possible. Returns the number of pairs and the sum of
/// their distances, s.
fn matching(expected: &[f64], found: &[f64]) -> (u64, f64) {
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
}

/// The error of an answer. A figure without a meaning is none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Difference {
    /// The share of the exact method's spikes that have a partner within [`MATCH_S`].
    pub(super) spikes_matched_share: Option<f64>,
    /// The mean distance of these pairs, µs.
    pub(super) mean_error_us: Option<f64>,
    /// The difference in rate, impulses/s RMS over afferents.
    pub(super) rate_rms_hz: Option<f64>,
    /// The excess of spikes, as a share of the exact method's.
    pub(super) rate_bias: Option<f64>,
}

impl<'s> Reference<'s> {
    /// `answer` is the exact one, with its spikes.
    pub(super) const fn new(scene: &'s Scene, answer: Answer) -> Self {
        Self { scene, answer }
    }

    pub(super) const fn answer(&self) -> &Answer {
        &self.answer
    }

    pub(super) fn spikes(&self) -> u64 {
        self.answer.counts.iter().sum()
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
        Difference {
            spikes_matched_share: (spikes > 0).then(|| matched as f64 / spikes as f64),
            mean_error_us: (matched > 0).then(|| sum_s / matched as f64 * 1e6),
            rate_rms_hz: (!exact.is_empty()).then(|| (squares / exact.len() as f64).sqrt()),
            rate_bias: (spikes > 0).then(|| of_answer as f64 / spikes as f64 - 1.0),
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
    fn errors_of_spikes_times_and_rates() {
        let afferents = vec![Position { x_mm: 0.0, y_mm: 0.0 }, Position { x_mm: 8.0, y_mm: 0.0 }];
        let model = AfferentModel::default_for(Rectify::Half, 0.0);
        let scene = Scene::new(Array::paper(), 0.5, 0, vec![], afferents, model).unwrap();
        let reference = Reference::new(&scene, answer(&[&[0.1, 0.2, 0.3], &[0.4]]));
        assert_eq!(reference.spikes(), 4);
        let same = reference.difference(reference.answer());
        let figures = [same.spikes_matched_share, same.mean_error_us, same.rate_rms_hz, same.rate_bias];
        assert_eq!(figures, [Some(1.0), Some(0.0), Some(0.0), Some(0.0)]);
        let other = reference.difference(&answer(&[&[0.1004, 0.2], &[]]));
        assert_eq!((other.spikes_matched_share, other.rate_bias), (Some(0.5), Some(-0.5)));
        assert!((other.mean_error_us.unwrap() - 200.0).abs() < 1e-6);
        // Both afferents lack 2 impulses/s.
        assert_eq!(other.rate_rms_hz, Some(2.0));
    }

    #[test]
    fn spikes_are_matched_in_order_one_to_one_within_a_millisecond() {
        for (expected, found, count, sum_s) in [
            (&[][..], &[][..], 0, 0.0),
            (&[0.1], &[], 0, 0.0),
            (&[0.1, 0.2], &[0.1, 0.2], 2, 0.0),
            (&[0.1, 0.2], &[0.1005, 0.1995], 2, 0.001),
            (&[0.1], &[0.1011], 0, 0.0),
            // One spike too many, one missing, two for one, one for two.
            (&[0.1, 0.3], &[0.1, 0.2, 0.3], 2, 0.0),
            (&[0.1, 0.2, 0.3], &[0.1, 0.3], 2, 0.0),
            (&[0.1], &[0.0995, 0.1], 1, 0.0005),
            (&[0.0995, 0.1], &[0.1], 1, 0.0005),
            // As many pairs as possible are matched, although the middle ones are nearer.
            (&[0.1, 0.1015], &[0.1008, 0.1024], 2, 0.0017),
        ] {
            let (matched, distance) = matching(expected, found);
            assert_eq!(matched, count, "{expected:?} {found:?}");
            assert!((distance - sum_s).abs() < 1e-12, "{expected:?} {found:?}: {distance}");
        }
    }

    #[test]
    fn an_empty_scene_has_no_figures() {
        let model = AfferentModel::default_for(Rectify::Half, 0.0);
        let scene = Scene::new(Array::paper(), 0.0, 0, vec![], vec![], model).unwrap();
        let reference = Reference::new(&scene, answer(&[]));
        let found = reference.difference(reference.answer());
        assert_eq!((found.spikes_matched_share, found.mean_error_us, found.rate_rms_hz), (None, None, None));
        assert_eq!(found.rate_bias, None);
    }
}
