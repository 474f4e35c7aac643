//! The pulses of 24 lines in ticks, as trains: the form in which pins and compiled strokes are compared.
//!
//! Invariant: the trains of a line are in order of time and do not overlap, and two trains without a gap between them have
//! different directions. So equal logs are equal in every tick.

use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_test_support::paper::MOTORS;
use std::fmt;

/// Pulses of one direction on consecutive ticks.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Train {
    /// The tick of the first pulse.
    pub start: Tick,
    /// Their direction.
    pub direction: Direction,
    /// Their number.
    pub pulses: u64,
}

impl Train {
    /// The first tick after it.
    pub fn end(&self) -> Tick {
        self.start + self.pulses
    }

    /// The pulses that it moves a pin up.
    pub fn signed(&self) -> i64 {
        if self.direction == Direction::Up { self.pulses as i64 } else { -(self.pulses as i64) }
    }

    /// The part in `from..to`.
    pub fn within(&self, from: Tick, to: Tick) -> Option<Self> {
        let start = self.start.max(from);
        let pulses = self.end().min(to) - start;
        (pulses > 0).then_some(Self { start, pulses, ..*self })
    }
}

impl fmt::Display for Train {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let since = self.start.since(Tick::BOOT);
        write!(out, "{} {:?} from tick BOOT+{since}", self.pulses, self.direction)
    }
}

impl fmt::Debug for Train {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, out)
    }
}

/// The trains of every line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Log {
    /// Per motor.
    pub lines: [Vec<Train>; MOTORS],
}

impl Log {
    /// Appends a train to a line, and joins it to the last one if it continues that. A train that does not come after the
    /// last stays separate, so that a comparison finds it.
    pub fn push(&mut self, line: usize, train: Train) {
        if train.pulses == 0 {
            return;
        }
        match self.lines[line].last_mut() {
            Some(last) if last.direction == train.direction && last.end() == train.start => {
                last.pulses += train.pulses;
            }
            _ => self.lines[line].push(train),
        }
    }

    /// A log of trains in any order.
    pub fn of(mut trains: Vec<(usize, Train)>) -> Self {
        trains.sort_by_key(|&(line, train)| (line, train.start));
        let mut log = Self::default();
        for (line, train) in trains {
            log.push(line, train);
        }
        log
    }

    /// The lines in `from..to`.
    pub fn within(&self, from: Tick, to: Tick) -> Self {
        let cut = |line: &Vec<Train>| line.iter().filter_map(|train| train.within(from, to)).collect();
        Self { lines: self.lines.each_ref().map(cut) }
    }

    /// The lines without the part in `from..to`.
    pub fn without(&self, from: Tick, to: Tick) -> Self {
        let sides = |train: &Train| [train.within(Tick(0), from), train.within(to, Tick(u64::MAX))];
        let cut = |line: &Vec<Train>| line.iter().flat_map(sides).flatten().collect();
        Self { lines: self.lines.each_ref().map(cut) }
    }

    /// Whether every pulse is also in `other`.
    pub fn is_part_of(&self, other: &Self) -> bool {
        let covered = |train: &Train, by: &[Train]| {
            let inside = |whole: &Train| whole.within(train.start, train.end()) == Some(*train);
            by.iter().any(|whole| whole.direction == train.direction && inside(whole))
        };
        self.lines.iter().zip(&other.lines).all(|(line, by)| line.iter().all(|train| covered(train, by)))
    }

    /// The first pulse of all lines.
    pub fn first(&self) -> Option<Tick> {
        self.lines.iter().filter_map(|line| line.first()).map(|train| train.start).min()
    }

    /// Pulses of all lines.
    pub fn pulses(&self) -> u64 {
        self.lines.iter().flatten().map(|train| train.pulses).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Direction::{Down, Up};

    fn train(start: u64, direction: Direction, pulses: u64) -> Train {
        Train { start: Tick(start), direction, pulses }
    }

    #[test]
    fn trains_that_touch_are_one_and_cutting_cuts_them() {
        let log = Log::of(vec![(3, train(10, Down, 5)), (3, train(5, Up, 5)), (3, train(15, Down, 2))]);
        assert_eq!(log.lines[3], [train(5, Up, 5), train(10, Down, 7)]);
        assert_eq!(log.within(Tick(8), Tick(12)).lines[3], [train(8, Up, 2), train(10, Down, 2)]);
        let split = [train(5, Up, 3), train(12, Down, 5)];
        assert_eq!(log.without(Tick(8), Tick(12)).lines[3], split);
        assert_eq!((log.first(), log.pulses()), (Some(Tick(5)), 12));
    }

    #[test]
    fn a_part_has_the_same_pulses_or_fewer() {
        let whole = Log::of(vec![(0, train(5, Up, 5)), (0, train(10, Down, 5))]);
        assert!(whole.within(Tick(7), Tick(12)).is_part_of(&whole));
        assert!(!Log::of(vec![(0, train(9, Up, 2))]).is_part_of(&whole));
        assert!(!Log::of(vec![(1, train(6, Up, 1))]).is_part_of(&whole));
        assert!(!Log::of(vec![(0, train(6, Down, 1))]).is_part_of(&whole));
    }
}
