//! What the pin of one motor did lately: the last moves that have left the queue, as planned.
//!
//! [`Trail::passed`] takes each move that was played, and [`Trail::cut`] the way down after a cut. [`Trail::movement`] computes from
//! these and from the moves under way how far the pin moved in a span of time, and how often.
//!
//! Invariant: it never allocates after [`Trail::new`]. With more moves than [`KEPT`] the oldest is forgotten, and the span is shorter.

use crate::queues::Movement;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::units::TickRate;
use std::collections::VecDeque;

/// Moves that are kept: those of strokes at 300 Hz in 0.2 s, or one every 1.6 ms.
const KEPT: usize = 128;

/// A move from level to level, pulses above rest, one pulse in each tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Passed {
    pub(super) start: Tick,
    pub(super) from: u16,
    pub(super) to: u16,
}

impl Passed {
    fn end(&self) -> Tick {
        self.start + u64::from(self.from.abs_diff(self.to))
    }

    /// The level at a tick; before the move the one that it begins at.
    fn level_at(&self, tick: Tick) -> u16 {
        let whole = self.from.abs_diff(self.to);
        let moved = u16::try_from(tick.since(self.start).max(0)).map_or(whole, |ticks| ticks.min(whole));
        if self.to > self.from { self.from + moved } else { self.from - moved }
    }

    fn direction(&self) -> Direction {
        if self.to > self.from { Direction::Up } else { Direction::Down }
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Trail(VecDeque<Passed>);

impl Trail {
    /// No move was played.
    pub(super) fn new() -> Self {
        let mut moves = VecDeque::with_capacity(KEPT);
        // Touch every page now, as the queue does.
        moves.resize(KEPT, Passed { start: Tick(0), from: 0, to: 0 });
        moves.clear();
        Self(moves)
    }

    /// A move has left the queue as played.
    pub(super) fn passed(&mut self, passed: Passed) {
        if passed.from == passed.to {
            return;
        }
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back(passed);
    }

    /// The device has cut the moves under way at `tick`, and brings the pin down.
    pub(super) fn cut(&mut self, tick: Tick) {
        let Some(last) = self.0.back_mut() else { return };
        last.to = last.level_at(tick);
        let from = last.to;
        self.passed(Passed { start: tick, from, to: 0 });
    }

    /// Nothing is known of the pin's past: the device's clock may have begun again.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// What the pin did from `from` to `now`, with the moves that came after those of the trail, in order. `rest` is its level if there
    /// is no move.
    pub(super) fn movement(
        &self,
        under_way: impl Iterator<Item = Passed>,
        rest: u16,
        [from, now]: [Tick; 2],
        rate: TickRate,
    ) -> Movement {
        let mut moves =
            self.0.iter().copied().chain(under_way).take_while(|passed| passed.start < now).peekable();
        let mut level = moves.peek().map_or(rest, |first| first.from);
        let (mut range, mut turns, mut before) = (None, Turns::default(), None);
        for passed in moves {
            let direction = Some(passed.direction());
            if passed.start >= from && direction != before {
                turns.add(passed);
            }
            before = direction;
            if passed.end() > from {
                let (low, high) = range.get_or_insert((level, level));
                for level in [passed.level_at(from), passed.level_at(now)] {
                    (*low, *high) = (level.min(*low), level.max(*high));
                }
            }
            level = passed.to;
        }
        let (low, high) = range.unwrap_or((level, level));
        Movement { low, high, hz: turns.per_s(now - from, rate) }
    }
}

/// Changes of direction in a span of time; a rise or a fall after the last one of the same kind is none.
#[derive(Debug, Default)]
struct Turns {
    count: u32,
    rises: u32,
    /// When the first and the last rise began.
    first: Tick,
    last: Tick,
}

impl Turns {
    fn add(&mut self, passed: Passed) {
        self.count += 1;
        if passed.direction() == Direction::Up {
            if self.rises == 0 {
                self.first = passed.start;
            }
            self.last = passed.start;
            self.rises += 1;
        }
    }

    /// Strokes per second: by the time from the first rise to the last. With fewer than two rises it is half the changes of direction, by
    /// the whole span of so many ticks.
    fn per_s(&self, span: u64, rate: TickRate) -> f32 {
        let (strokes, ticks) = match self.rises {
            0 | 1 => (f64::from(self.count) / 2.0, span),
            rises => (f64::from(rises - 1), self.last - self.first),
        };
        if ticks == 0 { 0.0 } else { (strokes / rate.ticks_to_seconds(ticks)) as f32 }
    }
}
