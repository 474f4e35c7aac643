//! When which line changes next, so that rendering looks at a line only then.
//!
//! Ticks are low halves, because the loop over all lines takes most of the chip's time. Invariant: a line whose slots change it
//! at some tick waits for that tick or an earlier one.

use crate::array::{CAPACITY, MotorSet};
use crate::controller::BLOCK;
use crate::tick::Tick;

#[derive(Clone, Debug)]
pub(super) struct Changes {
    /// Per motor, the tick at which its line changes next, if its bit in `waiting` is set.
    at: [u32; CAPACITY],
    waiting: MotorSet,
    window: Window,
}

impl Changes {
    /// No line changes. The window ends at `now`.
    pub(super) const fn none(now: Tick) -> Self {
        Self { at: [0; CAPACITY], waiting: MotorSet::EMPTY, window: Window::before(now) }
    }

    /// Notes that the line of `motor` has to be looked at in tick `low` or before.
    pub(super) fn by(&mut self, motor: usize, low: u32) {
        let bit = MotorSet::of(motor);
        if (self.waiting & bit).is_empty() || self.at[motor].wrapping_sub(low).cast_signed() > 0 {
            self.at[motor] = low;
        }
        self.waiting |= bit;
        self.window.add(bit, low);
    }

    /// Sets the tick at which the line of `motor`, which waits, changes next.
    pub(super) fn next(&mut self, motor: usize, low: u32) {
        self.at[motor] = low;
        self.window.add(MotorSet::of(motor), low);
    }

    /// The line of `motor` changes no more.
    pub(super) fn forget(&mut self, motor: usize) {
        self.waiting = self.waiting.without(MotorSet::of(motor));
    }

    /// Whether the line of `motor` is looked at again.
    pub(super) fn is_waiting(&self, motor: usize) -> bool {
        self.waiting.contains(motor as u8)
    }

    /// Whether the window has to be opened before the tick `now` is rendered.
    pub(super) fn is_over(&self, now: u32) -> bool {
        now.wrapping_sub(self.window.begin) >= BLOCK
    }

    /// Moves the window to `now`.
    #[inline(never)]
    pub(super) fn open(&mut self, now: u32) {
        self.window = Window { begin: now, ..Window::CLOSED };
        for (mut waiting, (changes, part)) in
            self.waiting.parts().into_iter().zip(self.at.chunks(32).zip(0..))
        {
            let mut bit = 1;
            for change in changes {
                if waiting & 1 == 1 {
                    // A change that is overdue happens now.
                    let ahead = change.wrapping_sub(now).cast_signed().max(0).cast_unsigned();
                    self.window.add(MotorSet::of_part(part, bit), now.wrapping_add(ahead));
                }
                waiting >>= 1;
                bit <<= 1;
            }
        }
    }

    /// Removes the lines that may change in the tick `now`, within the window.
    pub(super) fn take(&mut self, now: u32) -> MotorSet {
        self.window.take(now)
    }

    /// Ticks from `now` in which no line changes, at least 1, within the window.
    pub(super) fn quiet(&self, now: u32) -> u32 {
        self.window.quiet(now)
    }

    /// Ticks from `now` to the next change, while none is overdue.
    pub(super) fn first(&self, now: u32) -> u64 {
        let mut first = u32::MAX;
        for (mut waiting, changes) in self.waiting.parts().into_iter().zip(self.at.chunks(32)) {
            for change in changes {
                if waiting & 1 == 1 {
                    first = first.min(change.wrapping_sub(now));
                }
                waiting >>= 1;
            }
        }
        if self.waiting.is_empty() { u64::MAX } else { first.into() }
    }
}

/// The lines that may change in the next ticks, tick by tick, so that rendering a block looks at all lines only once. Ticks are
/// low halves.
#[derive(Clone, Debug)]
struct Window {
    /// The first tick.
    begin: u32,
    /// The lines that may change in each tick.
    lines: [MotorSet; BLOCK as usize],
    /// Bit i: lines may change in tick i.
    some: u32,
}

impl Window {
    /// A window that has to be opened before the next tick is rendered.
    const CLOSED: Self = Self { begin: 0, lines: [MotorSet::EMPTY; BLOCK as usize], some: 0 };

    /// A window that ends at `now`.
    const fn before(now: Tick) -> Self {
        Self { begin: (now.0 as u32).wrapping_sub(BLOCK), ..Self::CLOSED }
    }

    /// Notes that the line of `bit` changes at `tick`, if the window includes that tick.
    fn add(&mut self, bit: MotorSet, tick: u32) {
        let at = tick.wrapping_sub(self.begin);
        if let Some(lines) = self.lines.get_mut(at as usize) {
            *lines |= bit;
            self.some |= 1 << at;
        }
    }

    /// Removes the lines of the tick `now`.
    fn take(&mut self, now: u32) -> MotorSet {
        let at = now.wrapping_sub(self.begin);
        self.some &= !(1 << (at % BLOCK));
        self.lines.get_mut(at as usize).map_or(MotorSet::EMPTY, core::mem::take)
    }

    /// Ticks from `now` in which no line changes, at least 1, within the window.
    fn quiet(&self, now: u32) -> u32 {
        let at = now.wrapping_sub(self.begin) % BLOCK;
        let (mut ticks, mut later) = (1, self.some >> at >> 1);
        while later & 1 == 0 && at + ticks < BLOCK {
            later >>= 1;
            ticks += 1;
        }
        ticks
    }
}
