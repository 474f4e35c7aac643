//! What a pattern was made for, and how well it comes to it.
//!
//! A pattern made for a target keeps it in its provenance. Receptors within reach of the target
//! should fire and the others should not; how far they do, is said of rates that somebody else has simulated. Of a
//! target that moves each frame is judged by the spikes in its own time.
//!
//! Invariant: a verdict depends on the rates it is given and on where the receptors are, and on no word of the maker's.

use super::map::Aim;
use meissner_design::{Frame, Partition, Target, Verdict};
use meissner_skin::afferent::Position;
use serde::Serialize;

/// Frames that are drawn at the most.
const DRAWN: usize = 4;

/// What a pattern comes to for the target it was made for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TargetFigures {
    /// What the target is called.
    pub name: String,
    /// Every frame that was watched as a whole; of a target at rest there is one.
    pub frames: Vec<FrameFigures>,
}

/// A frame, and what comes of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameFigures {
    /// When it begins; none if the target does not move.
    pub start_s: Option<f64>,
    /// When it ends.
    pub stop_s: Option<f64>,
    /// What the rates are worth.
    #[serde(flatten)]
    pub verdict: Verdict,
}

/// A frame with the rates in its time.
#[derive(Clone, Debug)]
pub(super) struct Watched<'t> {
    pub(super) frame: &'t Frame,
    pub(super) partition: Partition,
    pub(super) rates_hz: Vec<f64>,
    pub(super) verdict: Verdict,
}

impl<'t> Watched<'t> {
    /// A frame, if there are receptors on both partition.
    pub(super) fn new(
        target: &Target,
        frame: &'t Frame,
        receptors: &[Position],
        rates_hz: Vec<f64>,
    ) -> Option<Self> {
        let partition = Partition::of(&frame.shape, target.reach_mm(), receptors);
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

/// The frames of a moving target that end by `watched_s`, each with the rates from its beginning to its end.
pub(super) fn frames<'t>(
    target: &'t Target,
    receptors: &[Position],
    spikes_s: &[Vec<f64>],
    watched_s: f64,
) -> Vec<Watched<'t>> {
    let watched = |frame: &'t Frame| {
        frame.stop_s.filter(|stop_s| *stop_s <= watched_s)?;
        Watched::new(target, frame, receptors, frame.rates_hz(spikes_s)?)
    };
    target.frames().iter().filter_map(watched).collect()
}

/// Which of so many frames are drawn: the first, the last and two between, or all if they are no more than that.
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
    use meissner_skin::afferent::population;

    #[test]
    fn the_first_the_last_and_two_between_are_drawn() {
        for (frames, indices) in
            [(0, &[][..]), (1, &[0]), (4, &[0, 1, 2, 3]), (5, &[0, 1, 3, 4]), (64, &[0, 21, 42, 63])]
        {
            assert_eq!(drawn(frames), indices);
        }
    }

    #[test]
    fn a_frame_has_the_spikes_of_its_own_time() {
        let target = shipped("moving-edge").unwrap();
        let receptors = population(0);
        let count = target.frames().len();
        let edges = |n: usize| target.frames()[n].start_s.unwrap();
        // One spike at each frame's very beginning, but two in the second.
        let mut train: Vec<f64> = (0..count).map(edges).collect();
        train.insert(2, edges(1) + 1e-6);
        let spikes_s = vec![train; receptors.len()];
        let found = frames(&target, &receptors, &spikes_s, 1.0);
        assert_eq!(found.len(), count);
        for (index, watched) in found.iter().enumerate() {
            let expected = if index == 1 { 2.0 } else { 1.0 } * count as f64;
            assert!(watched.rates_hz.iter().all(|rate| (rate - expected).abs() < 1e-6));
            assert_eq!((watched.verdict.cost_hz, watched.verdict.auc), (0.0, 0.5));
        }
        assert_eq!(frames(&target, &receptors, &spikes_s, 0.5 * edges(1)).len(), 0);
    }
}
