//! The verdict on a pattern for the target in its provenance.
//!
//! Each frame of a moving target is judged by the spikes in its time.
//!
//! Invariant: a verdict depends only on the target and on the rates and places of the afferents.

use crate::figures::baselines::Compared;
use crate::figures::map::Aim;
use meissner_design::{Frame, Partition, Target, Verdict};
use meissner_skin::membrane::Position;
use serde::Serialize;

/// The most frames that are drawn.
const DRAWN: usize = 4;

/// The verdicts on a pattern for its target.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TargetFigures {
    /// The name of the target.
    pub name: String,
    /// The frames that were simulated whole; a target at rest has one.
    pub frames: Vec<FrameFigures>,
    /// The pattern beside the naive rules, under both models.
    pub compared: Vec<Compared>,
}

/// A frame and its verdict.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameFigures {
    /// When it begins, s; none for a target at rest.
    pub start_s: Option<f64>,
    /// When it ends, s.
    pub stop_s: Option<f64>,
    /// The verdict on the rates.
    #[serde(flatten)]
    pub verdict: Verdict,
}

/// A frame and the rates in its time.
#[derive(Clone, Debug)]
pub(super) struct FrameRates<'t> {
    pub(super) frame: &'t Frame,
    pub(super) partition: Partition,
    pub(super) rates_hz: Vec<f64>,
    pub(super) verdict: Verdict,
}

impl<'t> FrameRates<'t> {
    /// The frame with its verdict; none if it has no ON or no OFF afferents.
    pub(super) fn new(
        target: &Target,
        frame: &'t Frame,
        afferents: &[Position],
        rates_hz: Vec<f64>,
    ) -> Option<Self> {
        let partition = Partition::of(&frame.shape, target.reach_mm(), afferents);
        let verdict = partition.verdict(&rates_hz)?;
        Some(Self { frame, partition, rates_hz, verdict })
    }

    pub(super) fn aim(&self) -> Aim<'_> {
        Aim { outline: self.frame.shape.outline(), on: self.partition.on() }
    }

    pub(super) const fn figures(&self) -> FrameFigures {
        FrameFigures { start_s: self.frame.start_s, stop_s: self.frame.stop_s, verdict: self.verdict }
    }
}

/// The frames of a moving target that end by `duration_s`, with the rates in their times.
pub(super) fn frames<'t>(
    target: &'t Target,
    afferents: &[Position],
    spikes_s: &[Vec<f64>],
    duration_s: f64,
) -> Vec<FrameRates<'t>> {
    let rates = |frame: &'t Frame| {
        frame.stop_s.filter(|stop_s| *stop_s <= duration_s)?;
        FrameRates::new(target, frame, afferents, frame.rates_hz(spikes_s)?)
    };
    target.frames().iter().filter_map(rates).collect()
}

/// The frames to draw: the first, the last and two between, or all if there are at most four.
pub(super) fn drawn(frames: usize) -> Vec<usize> {
    match frames.checked_sub(1) {
        Some(last) if last >= DRAWN => (0..DRAWN).map(|part| (part * last + 1) / (DRAWN - 1)).collect(),
        _ => (0..frames).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_design::shipped;
    use meissner_skin::membrane::population;

    #[test]
    fn the_first_the_last_and_two_between_are_drawn() {
        for (frames, indices) in
            [(0, &[][..]), (1, &[0]), (4, &[0, 1, 2, 3]), (5, &[0, 1, 3, 4]), (64, &[0, 21, 42, 63])]
        {
            assert_eq!(drawn(frames), indices);
        }
    }

    #[test]
    fn a_frame_counts_the_spikes_in_its_time() {
        let target = shipped("moving-edge").unwrap();
        let afferents = population(0);
        let count = target.frames().len();
        let edges = |n: usize| target.frames()[n].start_s.unwrap();
        // One spike at the beginning of each frame, and one more in the second.
        let mut train: Vec<f64> = (0..count).map(edges).collect();
        train.insert(2, edges(1) + 1e-6);
        let spikes_s = vec![train; afferents.len()];
        let found = frames(&target, &afferents, &spikes_s, 1.0);
        assert_eq!(found.len(), count);
        for (index, rates) in found.iter().enumerate() {
            let expected = if index == 1 { 2.0 } else { 1.0 } * count as f64;
            assert!(rates.rates_hz.iter().all(|rate| (rate - expected).abs() < 1e-6));
            assert_eq!((rates.verdict.cost_hz, rates.verdict.auc), (0.0, 0.5));
        }
        assert_eq!(frames(&target, &afferents, &spikes_s, 0.5 * edges(1)).len(), 0);
    }
}
