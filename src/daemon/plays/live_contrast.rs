//! Measures the contrast that live targets have reached: after a play, a process compares some of its poses with searches without a
//! deadline.
//!
//! Bounds: at most [`MOST`] poses of a play are kept. Invariant: one process at a time; it ends when the next live target begins.

use crate::daemon::beside::search_process::SearchProcess;
use crate::daemon::engine::Engine;
use crate::search::{self, Job, Report};
use meissner_api::LiveContrast;
use meissner_array::pattern::Drive;
use meissner_design::{LiveSample, Pose};

/// Poses that are compared, at most.
const MOST: usize = 8;

/// Poses of a play and their drives, spread evenly over those that were rendered.
#[derive(Debug)]
pub(in crate::daemon) struct PlayedPoses {
    /// One pose in this many is kept.
    every: u64,
    rendered: u64,
    kept: Vec<LiveSample>,
}

impl PlayedPoses {
    pub(in crate::daemon) fn new() -> Self {
        Self { every: 1, rendered: 0, kept: Vec::with_capacity(MOST) }
    }

    pub(in crate::daemon) fn add(&mut self, pose: Pose, drives: &[Drive]) {
        if self.rendered.is_multiple_of(self.every) {
            if self.kept.len() == MOST {
                let mut keep = [true, false].into_iter().cycle();
                self.kept.retain(|_| keep.next() == Some(true));
                self.every *= 2;
            }
            if self.rendered.is_multiple_of(self.every) {
                self.kept.push(LiveSample { pose, drives: drives.to_vec() });
            }
        }
        self.rendered += 1;
    }

    /// The poses, the earliest first.
    pub(in crate::daemon) fn into_kept(self) -> Vec<LiveSample> {
        self.kept
    }
}

impl Engine {
    /// Compares a play's poses with searches, and puts the result into its receipt. Takes a minute or two.
    pub(in crate::daemon) fn compare_live(&self, id: u64, job: &Job) {
        // Without the program, or if the system cannot start the process, the receipt has no contrast.
        let Some(Ok(mut process)) = search::command().map(SearchProcess::start) else { return };
        if !self.lock().begin_comparison(id, process.pid()) {
            return;
        }
        process.give(job);
        let mut last = None;
        while let Some(Report::Contrast(contrast)) = process.report() {
            last = Some(contrast);
        }
        let mut state = self.lock();
        state.end_comparison(id);
        if let Some(contrast) = last.filter(|contrast: &LiveContrast| contrast.poses > 0) {
            state.set_live_contrast(id, contrast);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_poses_are_spread_evenly_over_a_play_of_any_length() {
        for (rendered, every) in [(5, 1), (8, 1), (9, 2), (16, 2), (17, 4), (3_000, 512)] {
            let mut poses = PlayedPoses::new();
            for number in 0..rendered {
                poses.add(Pose { x_mm: f64::from(number), ..Pose::default() }, &[]);
            }
            let kept: Vec<f64> = poses.into_kept().iter().map(|sample| sample.pose.x_mm).collect();
            let expected: Vec<f64> = (0..rendered).step_by(every).map(f64::from).collect();
            assert_eq!(kept, expected, "{rendered}");
        }
    }
}
