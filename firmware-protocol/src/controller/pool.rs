//! Stroke slots and the queues of motors made of them.
//!
//! Each motor has a list of slots in the order of time: first those played or being played (`head`), then
//! the one that rendering has come to (`cursor`), then those to come (`tail`). A slot goes back to the pool
//! when its stroke lies in the past. What a line does at a tick follows from the slots alone ([`Slot::at`]),
//! so cutting a stroke means rewriting its slot, and nothing else remembers it.

use crate::stroke::{Direction, Line, MOTORS, Stroke};
use crate::tick::Tick;

/// Stroke slots of a controller.
pub const POOL: usize = 1024;

/// An index into the slots, or none.
pub(super) const NONE: u16 = u16::MAX;

/// What a slot's stroke is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A stroke of a play.
    Play,
    /// A play's stroke that was refused when it should have begun: it plays nothing.
    Void,
    /// A debt played down, or a move: not part of any play.
    Internal,
}

/// A stroke in the queue.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slot {
    /// As it will be played.
    pub(super) stroke: Stroke,
    /// Pulses as sent in its batch, up and down; the reference of corrections.
    pub(super) planned: [u16; 2],
    /// Generation of the amendment in force, up and down.
    pub(super) generation: [Option<u16>; 2],
    pub(super) kind: Kind,
    /// It has begun, and so many pulses were charged to the on-time account.
    pub(super) charged: Option<u32>,
    /// A return cut it short.
    pub(super) cut: bool,
    pub(super) next: u16,
}

impl Slot {
    pub(super) const fn new(stroke: Stroke, kind: Kind) -> Self {
        let planned = [stroke.up_pulses, stroke.down_pulses];
        Self { stroke, planned, generation: [None; 2], kind, charged: None, cut: false, next: NONE }
    }

    /// What the line does at `tick`, and until when; `None` once the stroke is over.
    pub(super) fn at(&self, tick: Tick) -> Option<(Line, Tick)> {
        let [up, down] = self.stroke.bursts();
        if tick < up.start {
            Some((Line::Off, up.start))
        } else if tick < up.end() {
            Some((Line::Pulse(Direction::Up), up.end()))
        } else if tick < down.start {
            Some((Line::Off, down.start))
        } else if tick < down.end() {
            Some((Line::Pulse(Direction::Down), down.end()))
        } else {
            None
        }
    }

    /// Whether something of it lies before `tick`. A debt being played down counts from the moment it is queued.
    pub(super) fn begun(&self, tick: Tick) -> bool {
        self.stroke.up < tick || (self.kind == Kind::Internal && self.stroke.up_pulses == 0)
    }

    /// Pulses that a move takes a pin up by and that cutting it at `tick` gives back, once.
    pub(super) fn shift_undone(&self, tick: Tick) -> u16 {
        let undone = self.kind == Kind::Internal && !self.cut && tick < self.stroke.bursts()[0].end();
        if undone { self.stroke.up_pulses } else { 0 }
    }

    /// Pulses of the up and of the down burst before `tick`.
    pub(super) fn played_before(&self, tick: Tick) -> [u16; 2] {
        self.stroke.bursts().map(|burst| {
            let passed = tick - burst.start;
            u16::try_from(passed).map_or(burst.pulses, |passed| passed.min(burst.pulses))
        })
    }

    /// Rewrites a begun stroke so that from `tick` on it only plays down what is owed; returns how much that is.
    pub(super) fn cut_at(&mut self, tick: Tick) -> u16 {
        let outstanding = self.outstanding_at(tick);
        let stroke = &mut self.stroke;
        if tick < stroke.up + u64::from(stroke.up_pulses) {
            stroke.up_pulses = outstanding;
        }
        if tick < stroke.down {
            (stroke.down, stroke.down_pulses) = (tick, outstanding);
            self.cut = true;
        }
        outstanding
    }

    /// Down pulses owed if the stroke is cut at `tick`: in the up burst those played; later the rest of the down burst.
    pub(super) fn outstanding_at(&self, tick: Tick) -> u16 {
        let [up, down] = self.played_before(tick);
        if up < self.stroke.up_pulses { up } else { self.stroke.down_pulses - down }
    }
}

/// A motor's list.
#[derive(Clone, Copy, Debug)]
pub(super) struct Queue {
    pub(super) head: u16,
    pub(super) cursor: u16,
    pub(super) tail: u16,
    /// How many slots it has.
    len: u16,
    /// How many of them are strokes of plays.
    plays: u16,
}

/// All slots, and who has them.
#[derive(Debug)]
pub(super) struct Pool {
    slots: [Slot; POOL],
    free: u16,
    used: u16,
    pub(super) queues: [Queue; MOTORS],
}

impl Pool {
    pub(super) const fn new() -> Self {
        let nothing = Stroke { motor: 0, up: Tick(0), up_pulses: 0, down: Tick(0), down_pulses: 0 };
        let mut slots = [Slot::new(nothing, Kind::Void); POOL];
        let mut next = 1;
        while next < POOL {
            slots[next - 1].next = next as u16;
            next += 1;
        }
        let queue = Queue { head: NONE, cursor: NONE, tail: NONE, len: 0, plays: 0 };
        Self { slots, free: 0, used: 0, queues: [queue; MOTORS] }
    }

    pub(super) fn free(&self) -> u16 {
        POOL as u16 - self.used
    }

    pub(super) fn is_empty(&self) -> bool {
        self.used == 0
    }

    pub(super) fn get(&self, index: u16) -> Option<&Slot> {
        self.slots.get(usize::from(index))
    }

    pub(super) fn get_mut(&mut self, index: u16) -> Option<&mut Slot> {
        self.slots.get_mut(usize::from(index))
    }

    /// The slot that rendering of `motor` has come to.
    pub(super) fn current(&self, motor: usize) -> Option<&Slot> {
        self.get(self.queues[motor].cursor)
    }

    /// The oldest slot of `motor`.
    pub(super) fn head(&self, motor: usize) -> Option<&Slot> {
        self.get(self.queues[motor].head)
    }

    /// When the last stroke of `motor` ends.
    pub(super) fn end(&self, motor: usize) -> Option<Tick> {
        self.get(self.queues[motor].tail).map(|slot| slot.stroke.end())
    }

    /// Queues a slot behind all others of its motor; `false` if there is none free.
    pub(super) fn push(&mut self, slot: Slot) -> bool {
        let index = self.free;
        let Some(place) = self.slots.get_mut(usize::from(index)) else { return false };
        self.free = place.next;
        *place = Slot { next: NONE, ..slot };
        self.used += 1;
        let motor = usize::from(slot.stroke.motor);
        let tail = self.queues[motor].tail;
        if let Some(last) = self.get_mut(tail) {
            last.next = index;
        }
        let queue = &mut self.queues[motor];
        if queue.head == NONE {
            queue.head = index;
        }
        if queue.cursor == NONE {
            queue.cursor = index;
        }
        queue.tail = index;
        queue.len += 1;
        queue.plays += u16::from(slot.kind != Kind::Internal);
        true
    }

    /// Moves the cursor of `motor` to the next slot.
    pub(super) fn advance(&mut self, motor: usize) {
        let next = self.current(motor).map_or(NONE, |slot| slot.next);
        self.queues[motor].cursor = next;
    }

    /// Gives the first slot of `motor` back.
    pub(super) fn pop(&mut self, motor: usize) -> Option<Slot> {
        let index = self.queues[motor].head;
        let slot = *self.get(index)?;
        let queue = &mut self.queues[motor];
        queue.head = slot.next;
        if queue.cursor == index {
            queue.cursor = slot.next;
        }
        if queue.tail == index {
            queue.tail = NONE;
        }
        queue.len -= 1;
        queue.plays -= u16::from(slot.kind != Kind::Internal);
        self.release(index, index, 1);
        Some(slot)
    }

    /// Gives back what `motor` has not begun: all behind the cursor's slot, and that one too unless `keep_current`.
    /// Returns how many strokes of plays there were. Takes no longer for many than for few.
    pub(super) fn flush(&mut self, motor: usize, keep_current: bool) -> u16 {
        let Queue { head, cursor, tail, len, plays } = self.queues[motor];
        let first = if keep_current { self.current(motor).map_or(NONE, |slot| slot.next) } else { cursor };
        if first == NONE {
            return 0;
        }
        let (mut kept, mut kept_plays, mut last, mut at) = (0, 0, NONE, head);
        while at != first {
            let Some(slot) = self.get(at) else { break };
            kept += 1;
            kept_plays += u16::from(slot.kind != Kind::Internal);
            (last, at) = (at, slot.next);
        }
        if let Some(slot) = self.get_mut(last) {
            slot.next = NONE;
        }
        let queue = &mut self.queues[motor];
        (queue.tail, queue.len, queue.plays) = (last, kept, kept_plays);
        if last == NONE {
            queue.head = NONE;
        }
        if !keep_current {
            queue.cursor = NONE;
        }
        self.release(first, tail, len - kept);
        plays - kept_plays
    }

    /// Gives back the `count` slots that hang together from `first` to `last`.
    fn release(&mut self, first: u16, last: u16, count: u16) {
        self.slots[usize::from(last)].next = self.free;
        self.free = first;
        self.used -= count;
    }

    /// The slot of the stroke of `motor` that begins at `up`, from the cursor on.
    pub(super) fn find(&self, motor: usize, up: Tick) -> Option<u16> {
        let mut index = self.queues.get(motor)?.cursor;
        while let Some(slot) = self.get(index) {
            if slot.stroke.up >= up {
                return (slot.stroke.up == up).then_some(index);
            }
            index = slot.next;
        }
        None
    }
}
