//! The moves that have not begun: a pool of slots, and a queue of them for each motor in order of time.
//!
//! A slot is free again in the moment in which its move begins. Ticks are low halves, compared as distances from the present: all moves lie
//! within 2^30 ticks.
//!
//! Invariant: the moves of a motor are in order of time, and each is at least `least_apart` ticks after the last but one before it, also after
//! those that have begun. So the chip has time to render them, and a stroke may be short.

use crate::array::CAPACITY;
use crate::moves::Move;
use crate::tick::Tick;
use core::hash::{Hash, Hasher};

/// Number of slots.
pub const POOL: usize = 2048;

/// The index that stands for no slot.
const NONE: u16 = u16::MAX;

/// A move that waits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    /// The low half of its tick.
    pub(super) tick: u32,
    pub(super) level: u16,
    pub(super) surplus: u16,
    /// Pulses that an amendment adds; they count only for a move from `from`.
    pub(super) correction: i16,
    /// The level before it, when it was queued.
    pub(super) from: u16,
    /// The newest amendment that it has taken, or that was older than the move.
    pub(super) generation: Option<u16>,
    /// It is the second move of a stroke, and stays as long as the first.
    pub(super) joined: bool,
    pub(super) next: u16,
}

#[derive(Clone, Copy, Debug)]
struct Queue {
    head: u16,
    tail: u16,
    len: u16,
    /// The tick of the last one that has begun and is not the second of a stroke.
    begun_first: Tick,
    /// The ticks of the motor's last two moves that have begun, the last one first; and of all its moves.
    begun: [Tick; 2],
    last: [Tick; 2],
}

#[derive(Clone, Debug)]
pub(super) struct Queues {
    free: u16,
    used: u16,
    queues: [Queue; CAPACITY],
    slots: [Waiting; POOL],
}

impl Hash for Queues {
    /// The moves that wait, in order.
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        for queue in &self.queues {
            (queue.len, queue.begun_first, queue.begun, queue.last).hash(hasher);
            let mut index = queue.head;
            while let Some(slot) = self.get(index) {
                let &Waiting { tick, level, surplus, correction, from, generation, joined, next } = slot;
                (tick, level, surplus, correction, from, generation, joined).hash(hasher);
                index = next;
            }
        }
    }
}

/// Whether `moves` may follow moves at these ticks, the last one first: each later than the one before it, and at least `apart` after the last
/// but one.
pub(super) fn follow(moves: &[Move], [mut last, mut before]: [Tick; 2], apart: u32) -> bool {
    moves.iter().all(|to| {
        let follows = to.tick > last && to.tick >= before + u64::from(apart);
        (last, before) = (to.tick, last);
        follows
    })
}

/// The moves of a queue before a tick.
struct Before {
    kept: u16,
    /// The last one of them, and the first one after them.
    last: u16,
    first: u16,
    /// The low halves of the ticks of the last two, the last one first.
    ticks: [u32; 2],
}

/// Looks for the moves of a queue before a tick, with the second moves of their strokes. The longest loop of the controller: by itself, so
/// that all it needs is in registers.
#[inline(never)]
fn before(slots: &[Waiting; POOL], head: u16, low: u32) -> Before {
    let mut found = Before { kept: 0, last: NONE, first: head, ticks: [0; 2] };
    let mut before = NONE;
    while let Some(slot) = slots.get(usize::from(found.first))
        && (slot.tick.wrapping_sub(low).cast_signed() < 0 || slot.joined)
    {
        before = core::mem::replace(&mut found.last, found.first);
        found.first = slot.next;
        found.kept += 1;
    }
    found.ticks = [found.last, before].map(|at| slots.get(usize::from(at)).map_or(0, |slot| slot.tick));
    found
}

/// Ticks from `now` to the low half of a tick within 2^31.
pub(super) const fn ahead(tick: u32, now: Tick) -> i32 {
    tick.wrapping_sub(now.0 as u32).cast_signed()
}

impl Waiting {
    pub(super) const NOTHING: Self = Self {
        tick: 0,
        level: 0,
        surplus: 0,
        correction: 0,
        from: 0,
        generation: None,
        joined: false,
        next: NONE,
    };
}

impl Queues {
    pub(super) const fn new() -> Self {
        let mut slots = [Waiting::NOTHING; POOL];
        let mut next = 1;
        while next < POOL {
            slots[next - 1].next = next as u16;
            next += 1;
        }
        let queue = Queue {
            head: NONE,
            tail: NONE,
            len: 0,
            begun_first: Tick(0),
            begun: [Tick(0); 2],
            last: [Tick(0); 2],
        };
        Self { free: 0, used: 0, queues: [queue; CAPACITY], slots }
    }

    pub(super) const fn free(&self) -> u16 {
        POOL as u16 - self.used
    }

    pub(super) fn len(&self, motor: usize) -> u16 {
        self.queues[motor].len
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.used == 0
    }

    fn get(&self, index: u16) -> Option<&Waiting> {
        self.slots.get(usize::from(index))
    }

    /// The next move of a motor.
    pub(super) fn first(&self, motor: usize) -> Option<&Waiting> {
        self.get(self.queues[motor].head)
    }

    /// The last move of a motor.
    pub(super) fn last(&self, motor: usize) -> Option<&Waiting> {
        self.get(self.queues[motor].tail)
    }

    /// The ticks of the motor's last two moves, queued or begun, the last one first.
    pub(super) fn last_ticks(&self, motor: usize) -> [Tick; 2] {
        self.queues[motor].last
    }

    /// Queues a move that begins at `at` behind the others of its motor. Returns `false` if no slot is free.
    pub(super) fn push(&mut self, motor: usize, at: Tick, waiting: Waiting) -> bool {
        let index = self.free;
        let Some(slot) = self.slots.get_mut(usize::from(index)) else { return false };
        self.free = slot.next;
        *slot = Waiting { next: NONE, ..waiting };
        self.used += 1;
        let tail = core::mem::replace(&mut self.queues[motor].tail, index);
        match self.slots.get_mut(usize::from(tail)) {
            Some(last) => last.next = index,
            None => self.queues[motor].head = index,
        }
        let queue = &mut self.queues[motor];
        queue.len += 1;
        queue.last = [at, queue.last[0]];
        true
    }

    /// Takes the next move of a motor, which begins at `now`.
    pub(super) fn begin(&mut self, motor: usize, now: Tick) -> Option<Waiting> {
        let index = self.queues[motor].head;
        let waiting = *self.get(index)?;
        let queue = &mut self.queues[motor];
        queue.begun = [now, queue.begun[0]];
        if !waiting.joined {
            queue.begun_first = now;
        }
        self.drop_first(motor);
        Some(waiting)
    }

    /// Frees the next move of a motor if it is the second of a stroke. Returns whether it was.
    pub(super) fn drop_second(&mut self, motor: usize) -> bool {
        let joined = self.first(motor).is_some_and(|next| next.joined);
        if joined {
            self.drop_first(motor);
        }
        joined
    }

    fn drop_first(&mut self, motor: usize) {
        let index = self.queues[motor].head;
        let Some(&Waiting { next, .. }) = self.get(index) else { return };
        let queue = &mut self.queues[motor];
        queue.head = next;
        queue.len -= 1;
        if next == NONE {
            queue.tail = NONE;
        }
        self.release(index, index, 1);
    }

    /// Frees all moves of a motor; returns their number.
    pub(super) fn flush(&mut self, motor: usize) -> u16 {
        let Queue { head, tail, len, .. } = self.queues[motor];
        if len > 0 {
            let queue = &mut self.queues[motor];
            *queue = Queue { head: NONE, tail: NONE, len: 0, last: queue.begun, ..*queue };
            self.release(head, tail, len);
        }
        len
    }

    /// Frees the moves of a motor from the tick `from` on; the second move of a stroke goes with its first. Returns their number, or `None`, and leaves them, if one has begun or the
    /// moves of `next` come too shortly after those before them.
    pub(super) fn withdraw(
        &mut self,
        motor: usize,
        from: Tick,
        next: &[Move],
        apart: u32,
        now: Tick,
    ) -> Option<u16> {
        let Queue { head, tail, len, begun, begun_first, .. } = self.queues[motor];
        if begun_first >= from {
            return None;
        }
        // Before all that waits, or after it: a distance of 2^31 has no sign.
        let limit = (from - now).min(1 << 30) as u32;
        let Before { kept, last, first, ticks: before } =
            before(&self.slots, head, (now.0 as u32).wrapping_add(limit));
        let at = |tick| Tick(now.0.wrapping_add_signed(ahead(tick, now).into()));
        let ticks = match kept {
            0 => begun,
            1 => [at(before[0]), begun[0]],
            _ => before.map(at),
        };
        if !follow(next, ticks, apart) {
            return None;
        }
        if kept == len {
            return Some(0);
        }
        match self.slots.get_mut(usize::from(last)) {
            Some(slot) => slot.next = NONE,
            None => self.queues[motor].head = NONE,
        }
        let queue = &mut self.queues[motor];
        (queue.tail, queue.len, queue.last) = (last, kept, ticks);
        self.release(first, tail, len - kept);
        Some(len - kept)
    }

    /// The tick of the last move of a motor that has begun.
    pub(super) fn begun(&self, motor: usize) -> Tick {
        self.queues.get(motor).map_or(Tick(u64::MAX), |queue| queue.begun[0])
    }

    /// The move of a motor at `tick`, and the low half of the tick of the one after it.
    pub(super) fn find(
        &mut self,
        motor: usize,
        tick: Tick,
        now: Tick,
    ) -> Option<(&mut Waiting, Option<u32>)> {
        let mut index = self.queues.get(motor)?.head;
        if !(0..1 << 30).contains(&tick.since(now)) {
            return None;
        }
        let tick = tick.0 as u32;
        while let Some(slot) = self.get(index) {
            if slot.tick == tick {
                let next = self.get(slot.next).map(|next| next.tick);
                return self.slots.get_mut(usize::from(index)).map(|slot| (slot, next));
            }
            index = slot.next;
        }
        None
    }

    /// Returns the `count` linked slots from `first` to `last` to the pool.
    fn release(&mut self, first: u16, last: u16, count: u16) {
        self.slots[usize::from(last)].next = self.free;
        self.free = first;
        self.used -= count;
    }
}
