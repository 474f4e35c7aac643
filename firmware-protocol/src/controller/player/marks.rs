//! The marks of a play that have not passed, and the trigger output that they drive.
//!
//! Invariant: a mark passes once, in order of time. The trigger output gives the cells of the newest trigger that was reached.

use crate::controller::player::NEVER;
use crate::message::{Counters, Trigger};
use crate::tick::Tick;

/// Most marks that are queued and have not passed.
const MAX_MARKS: usize = 8;

/// A mark, and the counts of the moment in which it was rendered.
#[derive(Clone, Copy, Debug)]
struct QueuedMark {
    at: Tick,
    trigger: Option<Trigger>,
    /// If it begins a play: for how many ticks a pin may be held from here on.
    hold: Option<u32>,
    counters: Option<Counters>,
}

#[derive(Clone, Debug)]
pub(super) struct Marks {
    queue: heapless::Deque<QueuedMark, MAX_MARKS>,
    output: TriggerOutput,
    /// What the last mark said of holds, until it is taken.
    hold: Option<u32>,
}

impl Marks {
    pub(super) const NONE: Self =
        Self { queue: heapless::Deque::new(), output: TriggerOutput::LOW, hold: None };

    pub(super) fn is_full(&self) -> bool {
        self.queue.is_full()
    }

    /// Queues a mark. There was room when its frame was read.
    pub(super) fn push(&mut self, at: Tick, trigger: Option<Trigger>, hold: Option<u32>) {
        let _ = self.queue.push_back(QueuedMark { at, trigger, hold, counters: None });
    }

    /// For how long pins may be held from now on, once after the mark of a play.
    pub(super) fn take_hold(&mut self) -> Option<u32> {
        self.hold.take()
    }

    pub(super) fn clear(&mut self) {
        self.queue.clear();
    }

    /// Forgets the marks from `at` on.
    pub(super) fn keep_before(&mut self, at: Tick) {
        self.queue.retain(|mark| mark.at < at);
    }

    /// Sets the trigger output low.
    pub(super) fn turn_off(&mut self) {
        self.output = TriggerOutput::LOW;
    }

    /// The oldest mark, if it lies before `now`; once, with the counts of its moment.
    pub(super) fn pass(&mut self, now: Tick) -> Option<(Tick, Counters)> {
        let &QueuedMark { at, counters, .. } = self.queue.front().filter(|mark| mark.at < now)?;
        self.queue.pop_front();
        Some((at, counters.unwrap_or(Counters::NONE)))
    }

    /// Whether the trigger is high at `now`, the rendered end, and the tick until which it stays so. `counters` are those of now.
    #[inline]
    pub(super) fn level(&mut self, now: Tick, counters: &Counters) -> (bool, Tick) {
        if self.queue.is_empty() && self.output.cells == 0 {
            return (false, NEVER);
        }
        self.pass_marks(now, counters)
    }

    #[inline(never)]
    fn pass_marks(&mut self, now: Tick, counters: &Counters) -> (bool, Tick) {
        let mut next = NEVER;
        for mark in &mut self.queue {
            if mark.at > now {
                next = next.min(mark.at);
            } else if mark.counters.is_none() {
                mark.counters = Some(*counters);
                self.hold = mark.hold.or(self.hold);
                if let Some(trigger) = mark.trigger {
                    self.output.begin(now, trigger);
                }
            }
        }
        let (high, until) = self.output.level(now);
        (high, next.min(until))
    }
}

/// The trigger output: the cells of a pulse or a code, one after the other.
#[derive(Clone, Debug)]
struct TriggerOutput {
    /// Bit 0 is the present cell, bit 1 the next one.
    cells: u16,
    /// Ticks of a cell.
    width: u16,
    /// The end of the present cell.
    cell_end: Tick,
}

impl TriggerOutput {
    /// An output that is low.
    const LOW: Self = Self { cells: 0, width: 1, cell_end: Tick(0) };

    /// Begins at `now`; ends what is on its way.
    fn begin(&mut self, now: Tick, trigger: Trigger) {
        // The start cell, then the code's bits. A code has no high cell after them.
        self.cells = 1 | u16::from(trigger.code) << 1;
        self.width = trigger.width.max(1);
        self.cell_end = now + u64::from(self.width);
    }

    /// Whether it is high at `now`, and the tick until which its cell lasts.
    fn level(&mut self, now: Tick) -> (bool, Tick) {
        while self.cells != 0 && self.cell_end <= now {
            self.cells >>= 1;
            self.cell_end = self.cell_end + u64::from(self.width);
        }
        if self.cells == 0 { (false, NEVER) } else { (self.cells & 1 == 1, self.cell_end) }
    }
}
