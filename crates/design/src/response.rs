//! The response of every afferent to patterns for a target, as shown in a map of the fingertip.
//!
//! [`response()`] simulates the population that the patterns were made for, once for each pattern, with the same noise. All patterns see
//! the same afferents, so their maps can be compared.
//!
//! Invariant: for a target at rest, ON minus OFF of these rates is the contrast that [`judge`](crate::judge()) finds.

use crate::judge::{STEADY_S, played};
use crate::partition::Partition;
use crate::quality::skin_model;
use crate::target::Target;
use meissner_array::pattern::Drive;
use meissner_skin::afferents::Class;
use meissner_skin::membrane::Position;
use meissner_skin::{Finger, MethodError, ModelName, Stimulus};

/// The RA afferents of a population, and their rates.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// Where each afferent lies.
    pub places: Vec<Position>,
    /// The share of the frames in which each afferent is ON, 0 to 1.
    pub on: Vec<f64>,
    /// For each pattern the mean rate of each afferent, impulses/s.
    pub rates_hz: Vec<Vec<f64>>,
}

/// The response to some patterns under a model. For a target at rest it covers one second, for a moving target the whole motion.
///
/// # Errors
/// If the drives cannot be simulated.
pub fn response(target: &Target, patterns: &[&[Drive]], model: ModelName) -> Result<Response, MethodError> {
    let seed = target.population_seed();
    let finger = Finger::new(skin_model(model, target), seed).only(Class::Ra);
    let places: Vec<Position> = finger.afferents().iter().map(|afferent| afferent.at).collect();
    let frames = target.frames();
    let mut on = vec![0.0; places.len()];
    for frame in frames {
        let partition = Partition::of(&frame.shape, target.reach_mm(), &places);
        for (share, _) in on.iter_mut().zip(partition.on()).filter(|(_, on)| **on) {
            *share += 1.0 / frames.len() as f64;
        }
    }
    let duration_s = if target.moves() { target.duration_s() } else { STEADY_S };
    let rates = |drives: &&[Drive]| {
        let counts = played(finger.counts(&Stimulus::of_drives(target.array(), drives, duration_s, seed)))?;
        Ok(counts.iter().map(|&count| count as f64 / duration_s).collect())
    };
    Ok(Response { places, on, rates_hz: patterns.iter().map(rates).collect::<Result<_, MethodError>>()? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::{Conditions, judge};
    use crate::naive::Rule;
    use crate::shipped::shipped;

    #[test]
    fn the_rates_of_a_map_have_the_contrast_of_the_verdict() {
        let target = shipped("edge-45").unwrap();
        let rules = Rule::ALL.map(|rule| rule.drives(&target));
        let patterns = rules.each_ref().map(Vec::as_slice);
        for model in [ModelName::Membrane, ModelName::Afferents] {
            let map = response(&target, &patterns, model).unwrap();
            assert_eq!((map.places.len(), map.rates_hz.len()), (306, 2));
            for (drives, rates_hz) in patterns.iter().zip(&map.rates_hz) {
                let mean = |wanted: f64| {
                    let of = map.on.iter().zip(rates_hz).filter(|(on, _)| **on == wanted);
                    let (count, sum) = of.fold((0.0, 0.0), |(count, sum), (_, hz)| (count + 1.0, sum + hz));
                    sum / count
                };
                let conditions = Conditions { model, ..Conditions::plain(vec![0], 0) };
                let verdict = judge(&target, drives, &conditions).unwrap().unwrap();
                assert!((mean(1.0) - mean(0.0) - verdict.cost_hz).abs() < 1e-9, "{model:?}");
            }
        }
    }

    #[test]
    fn an_afferent_of_a_moving_target_is_on_for_a_share_of_the_frames() {
        let target = shipped("rotating-edge").unwrap();
        let drives = Rule::Reach.drives(&target);
        let map = response(&target, &[&drives], ModelName::Membrane).unwrap();
        let part = map.on.iter().filter(|&&on| on > 0.0 && on < 0.99).count();
        assert!(part > 20, "{part}");
        assert!(map.on.iter().all(|on| (0.0..=1.0 + 1e-9).contains(on)));
        assert!(map.rates_hz[0].iter().any(|&hz| hz > 0.0));
    }
}
