//! The breakpoints of all motors, merged in order of time, block by block.
//!
//! A block has a bounded size, so a scene of a month takes no more memory than one of a second.
//!
//! Invariant: the order of breakpoints does not depend on the size of the blocks.

use crate::breakpoints::{Breakpoint, Breakpoints};
use crate::track::Track;
use meissner_array::spec::ArraySpec;
use rayon::prelude::*;

/// Approximate number of breakpoints in a block: they fit into a processor's inner cache.
const BLOCK: f64 = 16_384.0;

/// The breakpoints of some motors, block by block.
pub(crate) struct Blocks<'s> {
    motors: Vec<Source<'s>>,
    /// The end of the last block, half ticks.
    reached: f64,
    end: f64,
    length: f64,
}

/// Where a motor's breakpoints come from.
enum Source<'s> {
    /// The rest of its list.
    List(&'s [Breakpoint]),
    /// Too many for a list: the next one, and the source of those after it.
    Made(Breakpoints<'s>, Option<Breakpoint>),
}

impl<'s> Source<'s> {
    fn of(track: &'s Track) -> Self {
        track.list().map_or_else(
            || {
                let mut breakpoints = track.breakpoints();
                let first = breakpoints.next();
                Self::Made(breakpoints, first)
            },
            Self::List,
        )
    }

    /// Moves the breakpoints before an instant to the end of a block.
    fn take_before(&mut self, end: f64, block: &mut Vec<Breakpoint>) {
        match self {
            Self::List(list) => {
                let (before, rest) = list.split_at(list.partition_point(|found| found.at < end));
                block.extend_from_slice(before);
                *list = rest;
            }
            Self::Made(breakpoints, next) => {
                while let Some(found) = next.take_if(|found| found.at < end) {
                    block.push(found);
                    *next = breakpoints.next();
                }
            }
        }
    }
}

impl<'s> Blocks<'s> {
    pub(crate) fn new(array: &ArraySpec, tracks: impl Iterator<Item = &'s Track>, end: f64) -> Self {
        let tracks: Vec<_> = tracks.collect();
        let per_s: f64 = tracks.iter().map(|track| track.breakpoints_per_s()).sum();
        let least = 2.0 * array.motor().window_half_ticks as f64;
        let length = (BLOCK / per_s * array.rate().half_ticks_per_s()).max(least);
        // The lists are a tenth of the work: make them in parallel, too.
        let motors = tracks.into_par_iter().map(Source::of).collect();
        Self { motors, reached: 0.0, end, length }
    }

    /// The end of the last block, half ticks.
    pub(crate) const fn reached(&self) -> f64 {
        self.reached
    }

    /// Replaces a block by the next one. Breakpoints are in order of time, those of one instant in order of motor. If
    /// there is none left, it returns false and leaves the block as it is.
    pub(crate) fn next_into(&mut self, block: &mut Vec<Breakpoint>) -> bool {
        let from = self.reached;
        if from >= self.end {
            return false;
        }
        block.clear();
        let reached = (from + self.length).min(self.end);
        self.reached = reached;
        if self.motors.iter().all(|source| matches!(source, Source::List(_))) {
            self.motors.iter_mut().for_each(|source| source.take_before(reached, block));
        } else {
            let each = self.motors.par_iter_mut().map(|source| {
                let mut block = Vec::new();
                source.take_before(reached, &mut block);
                block
            });
            each.collect::<Vec<_>>().iter().for_each(|found| block.extend_from_slice(found));
        }
        // Stable, so that breakpoints of one instant stay in order of motor. Each motor's are sorted already.
        block.sort_by(|a, b| a.at.total_cmp(&b.at));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::membrane::{AfferentModel, Rectify};
    use crate::method::Method;
    use crate::scene::Scene;
    use crate::time::end;
    use crate::track::{Tracks, of_scene};
    use meissner_array::pattern::Drive;
    use meissner_array::spec::Array;
    use meissner_test_support::patterns::drive;
    use std::sync::Arc;

    /// Drives of all kinds: slow, fast, faster than the window, one after the other.
    fn scene() -> Scene {
        let drive = |motor: u8, hz, um| Drive { phase: 0.1 * f64::from(motor), ..drive(motor, hz, um) };
        let drives = vec![
            drive(0, 3.7, 120.0),
            drive(1, 61.0, 80.0),
            drive(2, 233.0, 80.0),
            drive(3, 4321.0, 2.0),
            drive(4, 42_500.0, 2.0),
            Drive { start_s: Some(0.3), ..drive(5, 100.0, 80.0) },
            Drive { stop_s: Some(0.2), ..drive(5, 200.0, 20.0) },
            drive(6, 50.0, 0.01),
        ];
        Scene::new(Array::paper(), 0.5, 0, drives, vec![], AfferentModel::default_for(Rectify::Half, 0.0))
            .unwrap()
    }

    fn tracks() -> Tracks {
        of_scene(&scene(), Method::Exact)
    }

    #[test]
    fn blocks_of_any_length_hold_the_same_breakpoints_in_the_same_order() {
        let (tracks, end) = (tracks(), end(scene().duration_s(), Array::paper().rate()));
        let all = tracks.iter().flatten().flat_map(|track| track.breakpoints());
        let mut expected: Vec<_> = all.filter(|found| found.at < end).collect();
        expected.sort_by(|a, b| a.at.total_cmp(&b.at).then(a.motor.cmp(&b.motor)));
        for length in [None, Some(1.0), Some(731.5), Some(10_000.0), Some(1e9)] {
            let mut blocks = Blocks::new(&Array::paper(), tracks.iter().flatten().map(Arc::as_ref), end);
            blocks.length = length.unwrap_or(blocks.length);
            // Take some motors from lists, and some not.
            for (source, track) in blocks.motors.iter_mut().zip(tracks.iter().flatten()).step_by(2) {
                let mut breakpoints = track.breakpoints();
                let first = breakpoints.next();
                *source = Source::Made(breakpoints, first);
            }
            let (mut found, mut block, mut reached) = (Vec::new(), Vec::new(), 0.0);
            while blocks.next_into(&mut block) {
                assert!(block.iter().all(|found| found.at >= reached && found.at < blocks.reached()));
                reached = blocks.reached();
                found.append(&mut block);
            }
            assert_eq!(reached, end);
            assert!(found == expected, "{length:?}");
        }
    }
}
