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
use core::task::Poll;

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
    /// What of one queue need not be searched again.
    search: Search,
    queues: [Queue; CAPACITY],
    slots: [Waiting; POOL],
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

/// How far the queue of a motor has been searched: so far all moves lie before a tick, with the second moves of their strokes.
///
/// A search is continued in the next piece of work, or by a search of the same queue for a later tick.
#[derive(Clone, Copy, Debug)]
struct Search {
    motor: usize,
    /// Moves passed, and the last two of them, the last one first.
    passed: u16,
    last: [u16; 2],
}

impl Search {
    const fn of(motor: usize) -> Self {
        Self { motor, passed: 0, last: [NONE; 2] }
    }

    /// Goes on from `first`, past at most `steps` moves, which it takes from them. Returns the move that it came to. The longest loop
    /// of the controller: by itself, so that all it needs is in registers.
    #[inline(never)]
    fn go_on(&mut self, slots: &[Waiting; POOL], mut first: u16, low: u32, steps: &mut u16) -> u16 {
        let Self { mut passed, last: [mut last, mut before], .. } = *self;
        let most = passed.saturating_add(*steps);
        while let Some(slot) = slots.get(usize::from(first))
            && (slot.joined || (slot.tick.wrapping_sub(low).cast_signed() < 0 && passed < most))
        {
            (before, last, first) = (last, first, slot.next);
            passed += 1;
        }
        *steps = most.saturating_sub(passed);
        (self.passed, self.last) = (passed, [last, before]);
        first
    }
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
        Self { free: 0, used: 0, search: Search::of(0), queues: [queue; CAPACITY], slots }
    }

    pub(super) const fn free(&self) -> u16 {
        POOL as u16 - self.used
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
        if self.search.motor == motor && self.search.passed > 0 {
            self.search.passed -= 1;
        }
        self.release(index, index, 1);
    }

    /// Frees all moves of a motor; returns their number.
    pub(super) fn flush(&mut self, motor: usize) -> u16 {
        let Queue { head, tail, len, .. } = self.queues[motor];
        if len > 0 {
            let queue = &mut self.queues[motor];
            *queue = Queue { head: NONE, tail: NONE, len: 0, last: queue.begun, ..*queue };
            self.search = Search::of(motor);
            self.release(head, tail, len);
        }
        len
    }

    /// Searches the queue of a motor for its first move from the tick `low` on that is no second one of a stroke, past at most `steps` moves, which
    /// it takes from them. `None`: not all moves before are passed yet; the next call goes on.
    fn search(&mut self, motor: usize, low: u32, steps: &mut u16) -> Option<u16> {
        let is_before = |slot: &Waiting| slot.tick.wrapping_sub(low).cast_signed() < 0;
        let Search { motor: of, passed, last: [last, _] } = self.search;
        let mut first = self.queues.get(motor)?.head;
        match self.get(last) {
            Some(slot) if of == motor && passed > 0 && is_before(slot) => first = slot.next,
            _ => self.search = Search::of(motor),
        }
        let first = self.search.go_on(&self.slots, first, low, steps);
        (!self.get(first).is_some_and(is_before)).then_some(first)
    }

    /// Frees the moves of a motor from the tick `from` on; the second move of a stroke goes with its first. Returns their number, or `None`, and leaves them, if one has begun or the
    /// moves of `next` come too shortly after those before them. Pending: as in [`Self::search`].
    pub(super) fn withdraw(
        &mut self,
        motor: usize,
        from: Tick,
        next: &[Move],
        apart: u32,
        now: Tick,
        steps: &mut u16,
    ) -> Poll<Option<u16>> {
        let Queue { tail, len, begun, begun_first, .. } = self.queues[motor];
        if begun_first >= from {
            return Poll::Ready(None);
        }
        // Before all that waits, or after it: a distance of 2^31 has no sign.
        let limit = (from - now).min(1 << 30) as u32;
        let Some(first) = self.search(motor, (now.0 as u32).wrapping_add(limit), steps) else {
            return Poll::Pending;
        };
        let Search { passed: kept, last, .. } = self.search;
        let at = |slot| {
            self.get(slot).map_or(now, |slot| Tick(now.0.wrapping_add_signed(ahead(slot.tick, now).into())))
        };
        let ticks = match kept {
            0 => begun,
            1 => [at(last[0]), begun[0]],
            _ => last.map(at),
        };
        if !follow(next, ticks, apart) {
            return Poll::Ready(None);
        }
        if kept == len {
            return Poll::Ready(Some(0));
        }
        let end = if kept > 0 { last[0] } else { NONE };
        match self.slots.get_mut(usize::from(end)) {
            Some(slot) => slot.next = NONE,
            None => self.queues[motor].head = NONE,
        }
        let queue = &mut self.queues[motor];
        (queue.tail, queue.len, queue.last) = (end, kept, ticks);
        self.release(first, tail, len - kept);
        Poll::Ready(Some(len - kept))
    }

    /// The tick of the last move of a motor that has begun.
    pub(super) fn begun(&self, motor: usize) -> Tick {
        self.queues.get(motor).map_or(Tick(u64::MAX), |queue| queue.begun[0])
    }

    /// The move of a motor at `tick`, and the low half of the tick of the one after it. Pending: as in [`Self::search`].
    pub(super) fn find(
        &mut self,
        motor: usize,
        tick: Tick,
        now: Tick,
        steps: &mut u16,
    ) -> Poll<Option<(&mut Waiting, Option<u32>)>> {
        if motor >= CAPACITY || !(0..1 << 30).contains(&tick.since(now)) {
            return Poll::Ready(None);
        }
        let low = tick.0 as u32;
        let Some(first) = self.search(motor, low, steps) else { return Poll::Pending };
        // The second move of a stroke has been passed.
        let Search { passed, last: [last, _], .. } = self.search;
        let mut at = [last, first].into_iter().skip(usize::from(passed == 0));
        let found = at.find(|&at| self.get(at).is_some_and(|slot| slot.tick == low));
        let next = found.and_then(|at| self.get(self.get(at)?.next)).map(|next| next.tick);
        Poll::Ready(found.and_then(|at| self.slots.get_mut(usize::from(at))).map(|slot| (slot, next)))
    }

    /// Returns the `count` linked slots from `first` to `last` to the pool.
    fn release(&mut self, first: u16, last: u16, count: u16) {
        self.slots[usize::from(last)].next = self.free;
        self.free = first;
        self.used -= count;
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// The moves of the queue of motor 1, each with its place.
    fn all(queues: &Queues) -> Vec<(u16, Waiting)> {
        let heads =
            core::iter::successors(Some(queues.queues[1].head), |&at| queues.get(at).map(|slot| slot.next));
        heads.map_while(|at| Some((at, *queues.get(at)?))).collect()
    }

    proptest! {
        /// Compared with a look at all moves. Between the pieces moves begin, are queued and withdrawn, and another queue is searched.
        #[test]
        fn a_search_in_pieces_finds_what_a_whole_one_does(
            moves in prop::collection::vec((1u32..4, any::<bool>()), 1..40),
            searches in prop::collection::vec((0usize..45, 0u32..4, 0u16..9, 0u8..6), 1..40),
        ) {
            let (mut queues, mut end) = (Queues::new(), 100);
            let mut push = |queues: &mut Queues, (after, joined)| {
                end += 2 * after;
                let joined = joined && all(queues).last().is_some_and(|(_, last)| !last.joined);
                queues.push(1, Tick(end.into()), Waiting { tick: end, joined, ..Waiting::NOTHING });
            };
            for &to in &moves {
                push(&mut queues, to);
            }
            for (at, beside, steps, event) in searches {
                let tick = all(&queues).get(at).map_or(end_of(&queues), |(_, to)| to.tick) + beside;
                // A search for nothing passes at least a move in each piece.
                for piece in 0.. {
                    let before = queues.search.passed;
                    let mut left = steps + 1;
                    let found = queues.search(1, tick, &mut left);
                    let list = all(&queues);
                    let kept = list.iter().position(|(_, to)| !to.joined && to.tick >= tick).unwrap_or(list.len());
                    let search = queues.search;
                    prop_assert!(piece < 50 && (piece == 0 || found.is_some() || search.passed > before));
                    if let Some(first) = found {
                        prop_assert_eq!((usize::from(search.passed), first), (kept, list.get(kept).map_or(NONE, |of| of.0)));
                        let last = list[..kept].iter().rev().map(|of| of.0).take(2);
                        prop_assert!(last.eq(search.last[..kept.min(2)].iter().copied()));
                        break;
                    }
                    prop_assert!(left == 0 && usize::from(search.passed) < kept);
                    match event {
                        0 => drop(queues.begin(1, Tick(100))),
                        1 => push(&mut queues, (1, true)),
                        2 => drop(queues.drop_second(1)),
                        _ => {}
                    }
                }
                let all = all(&queues);
                let at = Tick(tick.into());
                let found = all.iter().position(|(_, to)| to.tick == tick);
                if event == 3 && tick > 100 {
                    let taken = queues.withdraw(1, at, &[], 0, Tick(100), &mut u16::MAX.clone());
                    let kept = all.iter().position(|(_, to)| !to.joined && to.tick >= tick).unwrap_or(all.len());
                    prop_assert_eq!(taken, Poll::Ready(Some((all.len() - kept) as u16)));
                } else {
                    let same = queues.find(1, at, Tick(100), &mut u16::MAX.clone());
                    let next = |at: usize| (tick, all.get(at + 1).map(|(_, next)| next.tick));
                    prop_assert_eq!(same.map(|same| same.map(|(to, next)| (to.tick, next))), Poll::Ready(found.map(next)));
                }
            }
        }
    }

    fn end_of(queues: &Queues) -> u32 {
        all(queues).last().map_or(100, |(_, last)| last.tick)
    }
}
