//! Whether a play begins no more moves within 10 ms than the controller allows.
//!
//! A motor begins at most four strokes, which are eight moves, in 10 ms while it plays one drive after another or repeats one, unless
//! several such changes follow each other within 10 ms. Only then are the moves counted.

use super::counted;
use firmware_protocol::stroke::Direction;
use meissner_array::strokes::Strokes;
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

/// The first way up that begins after too many moves within 10 ms; `None`: the play keeps the limit.
#[must_use]
pub fn find_dense(strokes: &Strokes) -> Option<Dense> {
    if strokes.changes_are_apart(strokes.array().layout().dense_ticks().into()) {
        None
    } else {
        count(strokes)
    }
}

fn count(strokes: &Strokes) -> Option<Dense> {
    let array = strokes.array();
    let (ticks, most) = (u64::from(array.layout().dense_ticks()), usize::from(array.layout().max_dense()));
    // The moves that have begun in order, and the ways down that have not.
    let (mut begun, mut downs) = (VecDeque::with_capacity(most), BinaryHeap::new());
    for step in counted(strokes) {
        let mut bursts = step.bursts();
        let Some(first) = bursts.next() else { continue };
        downs.extend(bursts.map(|second| Reverse(second.start)));
        while let Some(&Reverse(down)) = downs.peek().filter(|Reverse(down)| *down <= first.start) {
            begun.push_back(down);
            downs.pop();
        }
        while begun.front().is_some_and(|before| first.start - *before >= ticks) {
            begun.pop_front();
        }
        if begun.len() >= most && first.direction == Direction::Up {
            return Some(Dense { at_s: array.rate().ticks_to_seconds(first.start.0), most });
        }
        begun.push_back(first.start);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Settings, simulate_play};
    use meissner_array::pattern::{Drive, Pattern};
    use meissner_array::simulated::SimulatedMotorsConfig;
    use meissner_array::spec::Array;
    use meissner_array::spec::names;
    use meissner_array::strokes::{Sequence, Start, StrokeOptions};
    use proptest::prelude::*;

    fn drive(motor: u8, phase: f64) -> Drive {
        Drive { motor, frequency_hz: 300.0, amplitude_um: 1.0, phase, start_s: None, stop_s: None }
    }

    /// All motors at 300 Hz, which repeats after so many ticks: one stroke of each in a repeat.
    fn repeating(ticks: u32) -> Pattern {
        let array = Array::paper();
        let drives = array.numbers().map(|motor| drive(motor, 0.0)).collect();
        Pattern::new(array, "dense", Some(f64::from(ticks) / 85_000.0), drives, toml::Table::new()).unwrap()
    }

    #[test]
    fn the_device_refuses_strokes_of_a_play_that_is_too_dense_and_of_no_other() {
        for (ticks, at_s) in
            [(213, None), (212, None), (211, Some(4.0 * 211.0 / 85_000.0)), (150, Some(0.6 / 85.0))]
        {
            let pattern = repeating(ticks);
            let strokes = Strokes::new(&pattern, &StrokeOptions::lasting(Some(0.1))).unwrap();
            let found = find_dense(&strokes);
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

    proptest! {
        /// A play whose strokes are not counted has no stroke too many.
        #[test]
        fn plays_whose_changes_are_apart_keep_the_limit(
            name in prop::sample::select(names()),
            phases in prop::collection::vec(0.0f64..1.0, 1..4),
            repeats in prop_oneof![Just(None), (850u32..1_100).prop_map(Some)],
            items in prop::collection::vec((0usize..3, 848u32..1_500), 2..30),
        ) {
            let array = Array::named(name).unwrap();
            let seconds = |ticks: u32| array.rate().ticks_to_seconds(ticks.into());
            let pattern = |phase: f64| {
                let drives = array.numbers().map(|motor| drive(motor, phase)).collect();
                Pattern::new(array, "p", repeats.map(seconds), drives, toml::Table::new())
            };
            let mut sequence = Sequence::new(array);
            let compiled: Vec<_> = phases
                .iter()
                .map(|&phase| sequence.compile(&pattern(phase).unwrap(), &StrokeOptions::default()).unwrap())
                .collect();
            for (at, ticks) in items {
                sequence.add(compiled[at % compiled.len()], Some(seconds(ticks)), Start::Gap(0.0)).unwrap();
            }
            let strokes = sequence.strokes().unwrap();
            prop_assert!(strokes.changes_are_apart(848) && count(&strokes).is_none());
        }
    }
}
