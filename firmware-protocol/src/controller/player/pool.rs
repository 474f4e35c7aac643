//! Stroke slots, and the queues of the motors made of them.
//!
//! Each motor has a list of slots in order of time, from `head` (the oldest) over `cursor` (the one being rendered) to
//! `tail` (the newest). A slot returns to the pool when its stroke lies in the past.
//!
//! Invariant: the state of a line at a tick follows from the slots alone ([`Slot::at`]). A cut rewrites the slot.

use crate::array::{CAPACITY, Layout};
use crate::stroke::{Direction, Line, Stroke};
use crate::tick::Tick;
use core::hash::{Hash, Hasher};

/// Number of stroke slots.
pub const POOL: usize = 1024;

/// The index that stands for no slot.
pub(super) const NONE: u16 = u16::MAX;

/// The purpose of a slot's stroke.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(in crate::controller) enum Kind {
    /// A stroke of a play.
    Play,
    /// A stroke of a play that was refused when it was to begin. It plays nothing.
    Void,
    /// Return pulses after an e-stop, or a move. Not part of a play.
    Internal,
    /// A seek of the lower stop. Not part of a play.
    Seek,
}

impl Kind {
    /// Whether it is a stroke of a play.
    const fn is_of_play(self) -> bool {
        matches!(self, Self::Play | Self::Void)
    }
}

/// A stroke in the queue.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slot {
    /// The stroke as it will be played.
    pub(super) stroke: Stroke,
    /// Up and down pulses as sent in the batch: the reference for corrections. For a motion that belongs to no play: the pulses
    /// up to the lower stop, and all pulses.
    pub(super) planned: [u16; 2],
    /// Generation of the amendment in force, per burst.
    pub(super) generation: [Option<u16>; 2],
    pub(super) kind: Kind,
    /// Most pulses of the down burst that push against a lower stop: the last ones. An amendment raises them.
    pub(super) pushes: u16,
    /// Once the stroke has begun, the pulses counted for the on-time limits.
    pub(super) charged: Option<u16>,
    /// A return has cut the stroke.
    pub(super) cut: bool,
    pub(super) next: u16,
}

impl Slot {
    pub(super) const fn new(stroke: Stroke, kind: Kind) -> Self {
        let planned = [stroke.up_pulses, stroke.down_pulses];
        let pushes = planned[1].saturating_sub(planned[0]);
        Self { stroke, planned, generation: [None; 2], kind, pushes, charged: None, cut: false, next: NONE }
    }

    /// The state of the line at `tick` and the ticks that it lasts; `None` after the stroke. The stroke lies within 2^31 ticks, so
    /// distances have 32 bits: the chip's core needs a call for many operations on 64.
    pub(super) fn at(&self, tick: Tick) -> Option<(Line, u32)> {
        let Stroke { up, up_pulses, down, down_pulses, .. } = self.stroke;
        let now = tick.0 as u32;
        let up = (up.0 as u32).wrapping_sub(now).cast_signed();
        let down = (down.0 as u32).wrapping_sub(now).cast_signed();
        let phases = [
            (Line::Off, up),
            (Line::Pulse(Direction::Up), up.wrapping_add(up_pulses.into())),
            (Line::Off, down),
            (Line::Pulse(Direction::Down), down.wrapping_add(down_pulses.into())),
        ];
        let present = phases.into_iter().find(|&(_, end)| end > 0);
        present.map(|(line, end)| (line, end.cast_unsigned()))
    }

    /// Whether some of the stroke lies before `tick`. Return pulses count from the moment they are queued.
    pub(super) fn begun(&self, tick: Tick) -> bool {
        self.stroke.up < tick || (!self.kind.is_of_play() && self.stroke.up_pulses == 0)
    }

    /// Pulses of a move's up burst that a cut at `tick` takes back, once.
    pub(super) fn shift_undone(&self, tick: Tick) -> u16 {
        let undone = self.kind == Kind::Internal && !self.cut && tick < self.stroke.bursts()[0].end();
        if undone { self.stroke.up_pulses } else { 0 }
    }

    /// Planned pulses against the lower stop: a return plays them, too.
    pub(super) fn surplus(&self) -> u16 {
        self.planned[1].saturating_sub(self.planned[0])
    }

    /// Sets the up pulses of an array with a lower stop. A shorter up burst leaves more of the down burst to push; a longer one does
    /// not lower the count, because a return may still push by the surplus.
    pub(super) fn raise_pushes(&mut self, up_pulses: u16) {
        self.pushes = self.planned[1].saturating_sub(up_pulses.min(self.planned[0]));
    }

    /// How many of [`Self::pushes`] lie before `tick`.
    pub(super) fn pushed_before(&self, tick: Tick) -> u16 {
        let free = self.stroke.down_pulses.saturating_sub(self.pushes);
        self.played_before(tick)[1].saturating_sub(free)
    }

    /// Up and down pulses before `tick`.
    pub(super) fn played_before(&self, tick: Tick) -> [u16; 2] {
        self.stroke.bursts().map(|burst| {
            let passed = tick - burst.start;
            u16::try_from(passed).map_or(burst.pulses, |passed| passed.min(burst.pulses))
        })
    }

    /// Rewrites a stroke that has begun: from `tick` on it plays only its outstanding return pulses, from `ready` on. Returns
    /// their number.
    pub(super) fn cut_at(&mut self, tick: Tick, ready: Tick) -> u16 {
        let outstanding = self.outstanding_at(tick);
        let stroke = &mut self.stroke;
        if tick < stroke.up + u64::from(stroke.up_pulses) {
            // At most the pulses of the burst.
            stroke.up_pulses = (tick - stroke.up) as u16;
        }
        if tick < stroke.down {
            (stroke.down, stroke.down_pulses) = (ready, outstanding);
            self.cut = true;
        }
        outstanding
    }

    /// Outstanding return pulses if the stroke is cut at `tick`: in its up burst the pulses played and the surplus, later the
    /// rest of its down burst.
    pub(super) fn outstanding_at(&self, tick: Tick) -> u16 {
        let [up, down] = self.played_before(tick);
        if up < self.stroke.up_pulses { up + self.surplus() } else { self.stroke.down_pulses - down }
    }
}

/// Pulses of a stroke, as the on-time limits count them. The limits keep the sum far below `u16::MAX`.
pub(super) fn charge(stroke: &Stroke) -> u16 {
    stroke.up_pulses.saturating_add(stroke.down_pulses)
}

/// A motor's list.
#[derive(Clone, Copy, Debug)]
pub(super) struct Queue {
    pub(super) head: u16,
    pub(super) cursor: u16,
    pub(super) tail: u16,
    /// Number of slots.
    len: u16,
    /// Number of slots that are strokes of plays.
    plays: u16,
    /// When the newest stroke before the cursor began, also if it is no longer in the list.
    passed: Tick,
}

/// All slots, and the motors' queues before them.
#[derive(Clone, Debug)]
#[repr(C)]
pub(super) struct Pool {
    free: u16,
    used: u16,
    /// Least ticks between the beginnings of a motor's strokes.
    least_apart: u32,
    pub(super) queues: [Queue; CAPACITY],
    slots: [Slot; POOL],
}

impl Hash for Pool {
    /// The slots that the queues hold, in order.
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        for queue in &self.queues {
            let &Queue { head, cursor, tail: _, len, plays, passed } = queue;
            (len, plays, passed).hash(hasher);
            let mut index = head;
            while let Some(slot) = self.get(index) {
                let &Slot { stroke, planned, generation, kind, pushes, charged, cut, next } = slot;
                (stroke, planned, generation, kind, pushes, charged, cut, index == cursor).hash(hasher);
                index = next;
            }
        }
    }
}

impl Pool {
    pub(super) const fn new(layout: &Layout) -> Self {
        let nothing = Stroke { motor: 0, up: Tick(0), up_pulses: 0, down: Tick(0), down_pulses: 0 };
        let mut slots = [Slot::new(nothing, Kind::Void); POOL];
        let mut next = 1;
        while next < POOL {
            slots[next - 1].next = next as u16;
            next += 1;
        }
        let queue = Queue { head: NONE, cursor: NONE, tail: NONE, len: 0, plays: 0, passed: Tick(0) };
        Self { free: 0, used: 0, least_apart: layout.least_apart(), queues: [queue; CAPACITY], slots }
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

    /// The slot of `motor` that is being rendered.
    pub(super) fn current(&self, motor: usize) -> Option<&Slot> {
        self.get(self.queues[motor].cursor)
    }

    pub(super) fn current_mut(&mut self, motor: usize) -> Option<&mut Slot> {
        self.get_mut(self.queues[motor].cursor)
    }

    /// The oldest slot of `motor`.
    pub(super) fn head(&self, motor: usize) -> Option<&Slot> {
        self.get(self.queues[motor].head)
    }

    /// Whether the oldest slot of `motor` is the one that is being rendered.
    pub(super) fn is_rendering_head(&self, motor: usize) -> bool {
        let queue = &self.queues[motor];
        queue.head == queue.cursor
    }

    /// Number of slots of `motor`.
    pub(super) fn len(&self, motor: usize) -> u16 {
        self.queues.get(motor).map_or(0, |queue| queue.len)
    }

    /// End of the last stroke of `motor`.
    pub(super) fn end(&self, motor: usize) -> Option<Tick> {
        self.get(self.queues[motor].tail).map(|slot| slot.stroke.end())
    }

    /// When the last stroke of `motor` begins or began.
    fn last_up(&self, motor: usize) -> Tick {
        let Some(queue) = self.queues.get(motor) else { return Tick(0) };
        self.get(queue.tail).map_or(queue.passed, |slot| slot.stroke.up)
    }

    /// The earliest tick at which another stroke of `motor` may begin.
    pub(super) fn earliest_up(&self, motor: usize) -> Tick {
        self.last_up(motor) + u64::from(self.least_apart)
    }

    /// Appends a slot to the queue of its motor. Returns `false` if the pool is full.
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
        queue.plays += u16::from(slot.kind.is_of_play());
        true
    }

    /// Moves the cursor of `motor` to the next slot.
    pub(super) fn advance(&mut self, motor: usize) {
        let Some(&Slot { next, stroke: Stroke { up, .. }, .. }) = self.current(motor) else { return };
        let queue = &mut self.queues[motor];
        (queue.cursor, queue.passed) = (next, up);
    }

    /// Returns the oldest slot of `motor` to the pool.
    pub(super) fn pop(&mut self, motor: usize) -> Option<Slot> {
        let slot = *self.head(motor)?;
        let passed = self.queues[motor].passed;
        self.drop_head(motor);
        // It may not have begun.
        self.queues[motor].passed = passed;
        Some(slot)
    }

    /// Like [`Self::pop`], for a stroke that has ended.
    pub(super) fn drop_head(&mut self, motor: usize) {
        let index = self.queues[motor].head;
        let Some(&Slot { next, kind, stroke: Stroke { up, .. }, .. }) = self.get(index) else { return };
        let queue = &mut self.queues[motor];
        queue.head = next;
        if queue.cursor == index {
            (queue.cursor, queue.passed) = (next, up);
        }
        if queue.tail == index {
            queue.tail = NONE;
        }
        queue.len -= 1;
        queue.plays -= u16::from(kind.is_of_play());
        self.release(index, index, 1);
    }

    /// Returns to the pool what `motor` has not begun: all slots behind the cursor, and the cursor's own unless
    /// `keep_current`. Returns the number of strokes of plays among them. Takes as long for many as for few.
    pub(super) fn flush(&mut self, motor: usize, keep_current: bool) -> u16 {
        let Queue { head, cursor, len, plays, .. } = self.queues[motor];
        let first = if keep_current { self.current(motor).map_or(NONE, |slot| slot.next) } else { cursor };
        if first == NONE {
            return 0;
        }
        let (mut stay, mut stay_plays, mut last, mut at) = (0, 0, NONE, head);
        while at != first {
            let Some(slot) = self.get(at) else { break };
            stay += 1;
            stay_plays += u16::from(slot.kind.is_of_play());
            (last, at) = (at, slot.next);
        }
        self.drop_from(motor, first, last, len - stay, plays - stay_plays);
        plays - stay_plays
    }

    /// Returns to the pool the strokes of `motor` that begin at `from` or later; returns their number. Returns `None` and leaves
    /// all of them if one has begun before `rendered` or is not of a play, or if one before them ends after `next` or begins too
    /// shortly before it.
    pub(super) fn withdraw(&mut self, motor: usize, from: Tick, next: Tick, rendered: Tick) -> Option<u16> {
        let &Queue { head, passed, .. } = self.queues.get(motor)?;
        if passed >= from {
            return None;
        }
        // Those before the cursor began before `from`, too.
        let [last, first, stay] = self.first_from(head, from);
        let [ends, begins] = self.get(last).map_or([passed; 2], |last| [last.stroke.end(), last.stroke.up]);
        if ends > next || next < begins + u64::from(self.least_apart) {
            return None;
        }
        let Some(slot) = self.get(first) else { return Some(0) };
        if slot.stroke.up < rendered || slot.kind != Kind::Play {
            return None;
        }
        // A motion that belongs to no play is queued alone, so what follows a stroke of a play is of a play, too.
        let dropped = self.queues[motor].len - stay;
        self.drop_from(motor, first, last, dropped, dropped);
        Some(dropped)
    }

    /// Finds the first stroke in the list `head` that begins at `from` or later. Returns the slot before it, its own slot, and
    /// the number of slots before it. Not inlined, so that the loop over a long queue needs no memory besides the slots.
    #[inline(never)]
    fn first_from(&self, head: u16, from: Tick) -> [u16; 3] {
        let (mut last, mut first, mut before) = (NONE, head, 0);
        while let Some(slot) = self.get(first) {
            if slot.stroke.up >= from {
                break;
            }
            (last, first) = (first, slot.next);
            before += 1;
        }
        [last, first, before]
    }

    /// Returns to the pool the slots of `motor` from `first` on: `slots` of them, of which `plays` are strokes of plays. `first`
    /// is the cursor or a later slot, `last` is the slot before it.
    fn drop_from(&mut self, motor: usize, first: u16, last: u16, slots: u16, plays: u16) {
        if let Some(slot) = self.get_mut(last) {
            slot.next = NONE;
        }
        let queue = &mut self.queues[motor];
        let tail = core::mem::replace(&mut queue.tail, last);
        queue.len -= slots;
        queue.plays -= plays;
        if last == NONE {
            queue.head = NONE;
        }
        if queue.cursor == first {
            queue.cursor = NONE;
        }
        self.release(first, tail, slots);
    }

    /// Returns to the pool the `count` linked slots from `first` to `last`.
    fn release(&mut self, first: u16, last: u16, count: u16) {
        self.slots[usize::from(last)].next = self.free;
        self.free = first;
        self.used -= count;
    }

    /// The slot, from the cursor on, of the stroke of `motor` that begins at `up`.
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
