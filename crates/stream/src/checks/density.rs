//! Whether a play begins no more moves within 10 ms than the controller allows.

use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::Step;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

/// More moves within 10 ms than may begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dense {
    /// When the first move too many begins, s from the onset.
    pub at_s: f64,
    /// How many may begin.
    pub most: usize,
}

/// Counts moves; steps come in order of their beginnings.
#[derive(Debug)]
pub(super) struct Density {
    array: Array,
    /// The moves that have begun in order, and the ways down that have not.
    begun: VecDeque<Tick>,
    downs: BinaryHeap<Reverse<Tick>>,
    /// The first way up that begins after too many moves within 10 ms.
    pub(super) found: Option<Dense>,
}

impl Density {
    pub(super) fn new(array: Array) -> Self {
        Self { array, begun: VecDeque::new(), downs: BinaryHeap::new(), found: None }
    }

    pub(super) fn push(&mut self, step: &Step) {
        let layout = self.array.layout();
        let (ticks, most) = (u64::from(layout.dense_ticks()), usize::from(layout.max_dense()));
        let mut bursts = step.bursts();
        let Some(first) = bursts.next().filter(|_| self.found.is_none()) else { return };
        self.downs.extend(bursts.map(|second| Reverse(second.start)));
        while let Some(&Reverse(down)) = self.downs.peek().filter(|Reverse(down)| *down <= first.start) {
            self.begun.push_back(down);
            self.downs.pop();
        }
        while self.begun.front().is_some_and(|before| first.start - *before >= ticks) {
            self.begun.pop_front();
        }
        if self.begun.len() >= most && first.direction == Direction::Up {
            let at_s = self.array.rate().ticks_to_seconds(first.start.0);
            self.found = Some(Dense { at_s, most });
        }
        self.begun.push_back(first.start);
    }
}

#[cfg(test)]
mod tests {
    use crate::{Settings, dry_run, simulate_play};
    use meissner_array::pattern::Pattern;
    use meissner_array::simulated::SimulatedMotorsConfig;
    use meissner_array::spec::Array;
    use meissner_array::strokes::{StrokeOptions, Strokes};
    use meissner_test_support::patterns::drive;

    /// All motors at 300 Hz, which repeats after so many ticks: one stroke of each in a repeat.
    fn repeating(ticks: u32) -> Pattern {
        let array = Array::paper();
        let drives = array.numbers().map(|motor| drive(motor, 300.0, 1.0)).collect();
        Pattern::new(array, "dense", Some(f64::from(ticks) / 85_000.0), drives, toml::Table::new()).unwrap()
    }

    #[test]
    fn the_device_refuses_strokes_of_a_play_that_is_too_dense_and_of_no_other() {
        for (ticks, at_s) in
            [(213, None), (212, None), (211, Some(4.0 * 211.0 / 85_000.0)), (150, Some(0.6 / 85.0))]
        {
            let pattern = repeating(ticks);
            let strokes = Strokes::new(&pattern, &StrokeOptions::lasting(Some(0.1))).unwrap();
            let found = dry_run(&strokes, &Settings::of(Array::paper())).dense;
            assert_eq!(found.is_some(), at_s.is_some(), "{ticks}: {found:?}");
            assert!(
                found.zip(at_s).is_none_or(|(found, at_s)| (found.at_s - at_s).abs() < 1e-9),
                "{ticks}: {found:?}"
            );
            let motors = SimulatedMotorsConfig::default();
            let played =
                simulate_play(&pattern, Some(0.1), &motors, Settings::of(Array::paper()), true).unwrap();
            let bursts = played.outcome.bursts;
            assert_eq!(bursts.refused > 0, at_s.is_some(), "{ticks}: {bursts:?}");
            assert_eq!(bursts.played + bursts.refused, bursts.planned, "{ticks}: {bursts:?}");
        }
    }
}
