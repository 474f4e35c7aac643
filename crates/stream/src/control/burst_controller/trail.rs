//! The ledger of one motor's past: the moves that have left the queue as played, each once.
//!
//! [`Trail::passed`] takes each move that was played, and [`Trail::cut`] the way down after a cut. What the pin did lately, when a play
//! was over and how many pulses the device has not counted yet are read from it.
//!
//! Invariant: it never allocates after [`Trail::new`]. Its moves are in order. With more than [`KEPT`] the oldest is forgotten.

use crate::control::queued::Forgotten;
use crate::queues::Movement;
use firmware_protocol::controller::HORIZON;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Burst;
use meissner_array::units::TickRate;
use std::collections::VecDeque;

/// Moves that are kept: those of strokes at 300 Hz in 6.8 s. A play is closed 5 s after its end at the latest, if reports are missing.
const KEPT: usize = 4096;

/// A move from level to level, pulses above rest, one pulse in each tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Passed {
    /// As corrected; without pulses on the way down after a cut.
    pub(crate) burst: Burst,
    pub(in crate::control) from: u16,
    pub(crate) to: u16,
}

impl Passed {
    /// Its end as planned.
    fn end(&self) -> Tick {
        self.burst.start + u64::from(self.from.abs_diff(self.to))
    }

    /// The level at a tick; before the move the one that it begins at.
    fn level_at(&self, tick: Tick) -> u16 {
        let whole = self.from.abs_diff(self.to);
        let moved =
            u16::try_from(tick.since(self.burst.start).max(0)).map_or(whole, |ticks| ticks.min(whole));
        if self.to > self.from { self.from + moved } else { self.from - moved }
    }

    fn direction(&self) -> Direction {
        if self.to > self.from { Direction::Up } else { Direction::Down }
    }

    /// The way down after a cut.
    const fn down(start: Tick, from: u16) -> Self {
        Self { burst: Burst { start, direction: Direction::Down, pulses: 0 }, from, to: 0 }
    }
}

/// See the module.
#[derive(Clone, Debug)]
pub(crate) struct Trail {
    moves: VecDeque<Passed>,
    /// The move that [`Self::cut`] has cut last, as it was planned.
    uncut: Option<Passed>,
}

impl Trail {
    /// No move was played.
    pub(crate) fn new() -> Self {
        let mut moves = VecDeque::with_capacity(KEPT);
        // Touch every page now, as the queue does.
        moves.resize(KEPT, Passed::down(Tick(0), 0));
        moves.clear();
        Self { moves, uncut: None }
    }

    /// A move has left the queue as played.
    pub(crate) fn passed(&mut self, passed: Passed) {
        if self.moves.len() == KEPT {
            self.moves.pop_front();
        }
        self.moves.push_back(passed);
    }

    /// The device has cut the moves under way at `tick`, and brings the pin down.
    pub(crate) fn cut(&mut self, tick: Tick) {
        let Some(last) = self.moves.back_mut() else { return };
        if last.burst.pulses > 0 {
            self.uncut = Some(*last);
        }
        last.to = last.level_at(tick);
        last.burst.pulses = last.burst.pulses.min(u16::try_from(tick - last.burst.start).unwrap_or(u16::MAX));
        if last.to > 0 {
            let from = last.to;
            self.passed(Passed::down(tick, from));
        }
    }

    /// The device says at which tick it has cut what [`Self::cut`] knew of: within the render horizon later, or earlier.
    pub(crate) fn was_cut(&mut self, at: Tick) {
        // What came after the way down is not concerned, nor is a cut long ago.
        let is_last = |last: &Passed| last.burst.pulses == 0 && at <= last.burst.start + u64::from(HORIZON);
        let Some(uncut) = self.uncut.take().filter(|_| self.moves.back().is_some_and(is_last)) else {
            return;
        };
        while self.moves.back().is_some_and(|last| last.burst.start >= uncut.burst.start.min(at)) {
            self.moves.pop_back();
        }
        if uncut.burst.start < at {
            self.moves.push_back(uncut);
        }
        self.cut(at);
        self.uncut = None;
    }

    /// The way down after the last cut, if nothing came after it: from so many pulses above rest.
    pub(crate) fn way_down(&mut self) -> Option<&mut Passed> {
        self.moves.back_mut().filter(|last| last.burst.pulses == 0 && last.to == 0)
    }

    /// The device has not played so many moves from the one that begins at this tick.
    pub(crate) fn withdrawn(&mut self, begin: Tick, moves: usize) {
        let Some(at) = self.moves.iter().rposition(|passed| passed.burst.start == begin) else { return };
        let gone = self.moves.range(at..).take(moves).take_while(|passed| passed.burst.pulses > 0).count();
        let level = self.moves[at].from;
        self.moves.drain(at..at + gone);
        if let Some(next) = self.moves.get_mut(at) {
            next.from = level;
        }
    }

    /// The level after the last move, pulses above rest.
    pub(crate) fn level(&self) -> u16 {
        self.moves.back().map_or(0, |last| last.to)
    }

    /// The moves that the device has played.
    pub(crate) fn played(&self) -> impl DoubleEndedIterator<Item = Passed> {
        self.moves.iter().filter(|passed| passed.burst.pulses > 0).copied()
    }

    /// The last move that began at `from` or later and before `until`.
    pub(crate) fn last(&self, from: Tick, until: Tick) -> Result<Option<Passed>, Forgotten> {
        let is_short =
            self.moves.len() == KEPT && self.moves.front().is_some_and(|first| first.burst.start >= until);
        let last = self.played().rev().find(|passed| passed.burst.start < until);
        if is_short { Err(Forgotten) } else { Ok(last.filter(|last| last.burst.start >= from)) }
    }

    /// The tick after which no move was under way.
    pub(crate) fn still_from(&self) -> Tick {
        self.moves.back().map_or(Tick(0), |last| last.burst.end())
    }

    /// Nothing is known of the pin's past: the device's clock may have begun again.
    pub(crate) fn clear(&mut self) {
        self.moves.clear();
        self.uncut = None;
    }

    /// The moves from the one on that may be under way at `from`.
    fn since(&self, from: Tick) -> impl Iterator<Item = Passed> {
        let first = self.moves.partition_point(|passed| passed.burst.start < from).saturating_sub(1);
        self.moves.range(first..).copied()
    }

    /// Calls `level` with each of these ticks, which are in order, and the level at it. Takes each move once.
    pub(crate) fn course(
        &self,
        under_way: impl Iterator<Item = Passed>,
        ticks: impl Iterator<Item = Tick>,
        mut level: impl FnMut(Tick, u16),
    ) {
        let mut ticks = ticks.peekable();
        let Some(&from) = ticks.peek() else { return };
        let mut moves =
            self.since(from).chain(under_way).filter(|passed| passed.from != passed.to).peekable();
        let mut last = moves.peek().copied();
        for tick in ticks {
            while let Some(begun) = moves.next_if(|next| next.burst.start <= tick) {
                last = Some(begun);
            }
            level(tick, last.map_or(self.level(), |last| last.level_at(tick)));
        }
    }

    /// What the pin did from `from` to `now`, with the moves that came after those of the trail, in order.
    pub(crate) fn movement(
        &self,
        under_way: impl Iterator<Item = Passed>,
        [from, now]: [Tick; 2],
        rate: TickRate,
    ) -> Movement {
        let moves = self.since(from).chain(under_way).filter(|passed| passed.from != passed.to);
        let mut moves = moves.take_while(|passed| passed.burst.start < now).peekable();
        let mut level = moves.peek().map_or(self.level(), |first| first.from);
        let (mut range, mut turns, mut before) = (None, Turns::default(), None);
        for passed in moves {
            let direction = Some(passed.direction());
            if passed.burst.start >= from && direction != before {
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
                self.first = passed.burst.start;
            }
            self.last = passed.burst.start;
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
