//! What one motor does: how high its pin is, how high it should be, and the burst that runs.
//!
//! Limits are not here: the player asks them before a burst begins.
//!
//! Invariant: while no burst runs, `height` is where the pin is. Within a burst it counts the pulses that were played; at its end the pin is
//! where the burst was to bring it, because a correction is no height.

use crate::stroke::Direction;
use crate::tick::{HORIZON, Tick};

/// A burst that runs. Ticks are low halves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Running {
    pub(super) direction: Direction,
    start: u32,
    pub(super) pulses: u16,
    /// The height at its end.
    to: u16,
    /// How many of its last pulses push against the lower stop.
    pub(super) pushes: u16,
}

/// A burst that moves the pin by another number of pulses than it has: a corrected one, one that pushes, a shift of rest.
#[derive(Clone, Copy, Debug)]
struct Uneven {
    of: Running,
    /// The height before it.
    from: u16,
}

/// How many uneven bursts of a motor may have ticks within the horizon.
const UNEVEN: usize = 4;

/// In this order, what rendering uses most lies where the chip's short loads reach it.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Motor {
    /// Where the pin is, or where the running burst began.
    pub(super) height: u16,
    /// The level that the pin should have.
    goal: u16,
    pub(super) running: Option<Running>,
    /// For the way down to the goal: the pulses that an amendment adds, and the surplus.
    pub(super) correction: i16,
    pub(super) surplus: u16,
    /// By how many pulses the pin may be below `height`, because ways up since it was at rest were corrected to fewer.
    below: u16,
    /// When the last burst ended.
    pub(super) still_since: Tick,
    /// The last uneven bursts with ticks that may not have been played, in a ring.
    uneven: [Option<Uneven>; UNEVEN],
}

impl Running {
    /// The low half of the first tick after its last pulse.
    pub(super) const fn end(&self) -> u32 {
        self.start.wrapping_add(self.pulses as u32)
    }

    /// Pulses before the tick `now`.
    pub(super) fn played(&self, now: u32) -> u16 {
        let passed = now.wrapping_sub(self.start).cast_signed().max(0);
        u16::try_from(passed).map_or(self.pulses, |passed| passed.min(self.pulses))
    }

    /// The height at the tick `now`, if it was `from` before. Only at its end does it not follow from the pulses.
    fn height(&self, from: u16, now: u32) -> u16 {
        let played = self.played(now);
        match self.direction {
            _ if played == self.pulses => self.to,
            // A shift of rest goes up from level 0 to level 0.
            Direction::Up if self.to <= from => from.saturating_add(played),
            Direction::Up => from.saturating_add(played).min(self.to),
            Direction::Down => from.saturating_sub(played).max(self.to),
        }
    }

    /// The burst as it is if it ends at the tick `now`, and the height was `from` before.
    #[inline(never)]
    fn until(&self, from: u16, now: u32) -> Self {
        let pulses = self.played(now);
        let pushes = pulses.saturating_sub(self.pulses - self.pushes);
        Self { pulses, pushes, to: self.height(from, now), ..*self }
    }

    /// By how many pulses it brings the pin lower than its height, which was `from` before.
    fn below(&self, from: u16) -> i16 {
        let (higher, pulses) = (self.to.wrapping_sub(from), self.pulses - self.pushes);
        match self.direction {
            Direction::Up => higher.wrapping_sub(pulses).cast_signed(),
            Direction::Down => higher.wrapping_add(pulses).cast_signed(),
        }
    }
}

impl Motor {
    pub(super) const REST: Self = Self {
        height: 0,
        goal: 0,
        running: None,
        correction: 0,
        surplus: 0,
        below: 0,
        still_since: Tick(0),
        uneven: [None; UNEVEN],
    };

    pub(super) const fn goal(&self) -> u16 {
        self.goal
    }

    /// Pulses above rest at the tick `now`.
    pub(super) fn height(&self, now: u32) -> u16 {
        self.running.map_or(self.height, |running| running.height(self.height, now))
    }

    /// Pulses until it is where it should be, if no other move begins.
    pub(super) fn left(&self, now: u32) -> u32 {
        let then = self.running.map_or(self.height, |running| running.to);
        let (left, way) = (self.running.map_or(0, |of| of.pulses - of.played(now)), then.abs_diff(self.goal));
        let more =
            if self.running.is_none() { i32::from(self.correction) + i32::from(self.surplus) } else { 0 };
        u32::from(left)
            + if way > 0 || more > 0 { u32::from(way).saturating_add_signed(more).max(1) } else { 0 }
    }

    /// The pulses down that it still has to begin until its pin is at rest.
    pub(super) fn back(&self) -> u16 {
        match self.running {
            // A shift of rest that is cut is driven back.
            Some(Running { direction: Direction::Up, pulses, to: 0, .. }) => pulses,
            Some(running) => running.to,
            None => self.height,
        }
    }

    /// Whether its pin is above its goal, or is to push, and no burst runs.
    pub(super) const fn is_to_descend(&self) -> bool {
        self.running.is_none() && (self.height > self.goal || self.surplus > 0)
    }

    /// Whether no burst runs and the pin is where it should be.
    pub(super) const fn is_still(&self) -> bool {
        self.running.is_none() && self.height == self.goal && self.surplus == 0
    }

    /// Ends the burst that runs, at `now`. Returns it as it was begun, and as it was played.
    #[inline(always)]
    pub(super) fn end(&mut self, now: Tick) -> Option<(Running, Running)> {
        let begun = self.running?;
        let played = if begun.end() == now.0 as u32 { begun } else { self.cut_short(begun, now.0 as u32) };
        let before = core::mem::replace(&mut self.height, played.to);
        // Only an uneven burst takes the pin to another place than its height says.
        if self.below > 0 || self.uneven[0].is_some() {
            self.go_below(played.below(before));
        }
        (self.running, self.still_since) = (None, now);
        Some((begun, played))
    }

    /// The burst that runs ends early.
    #[inline(never)]
    fn cut_short(&mut self, begun: Running, now: u32) -> Running {
        let played = begun.until(self.height, now);
        if let Some(uneven) = self.uneven[0].as_mut().filter(|uneven| uneven.of == begun) {
            uneven.of = played;
        }
        played
    }

    /// Where the pin is, and where it should be, without a burst.
    pub(super) fn place(&mut self, height: u16, goal: u16) {
        let Self { still_since, uneven, .. } = *self;
        let below = if height == self.height { self.below } else { 0 };
        *self = Self { height, goal, still_since, uneven, below, ..Self::REST };
    }

    /// The pin should have this level. A burst to another one has been ended.
    pub(super) fn set_goal(&mut self, level: u16) {
        (self.goal, self.correction, self.surplus) = (level, 0, 0);
    }

    /// The pin is by so many pulses lower than by its height, than it was.
    fn go_below(&mut self, pulses: i16) {
        self.below = self.below.saturating_add_signed(pulses).min(self.height);
    }

    /// How many of the pulses down that bring it to rest push against a lower stop, if no way up is corrected from now on.
    pub(super) fn left_to_push(&self) -> u16 {
        if self.height == 0 { 0 } else { self.below }
    }

    /// Begins a burst at `now`, after which the pin has the height `to`.
    pub(super) fn begin(&mut self, now: Tick, direction: Direction, pulses: u16, pushes: u16, to: u16) {
        let of = Running { direction, start: now.0 as u32, pulses, to, pushes };
        self.running = Some(of);
        // No earlier, because an e-stop may take back the end of the way to rest.
        self.below = self.left_to_push();
        // The first one is the newest.
        if self.uneven[0].is_some() {
            self.forget_played(now);
        }
        if pulses != self.height.abs_diff(to) || pushes > 0 {
            self.note_uneven(Uneven { of, from: self.height });
        }
    }

    #[inline(never)]
    fn note_uneven(&mut self, uneven: Uneven) {
        // Without a newest one there are none.
        if self.uneven[0].is_some() {
            self.uneven.rotate_right(1);
        }
        self.uneven[0] = Some(uneven);
    }

    /// Forgets the uneven bursts all of whose ticks were played.
    #[inline(never)]
    fn forget_played(&mut self, now: Tick) {
        let pauses = now - self.still_since > u64::from(HORIZON);
        for place in &mut self.uneven {
            let ago = |uneven: &Uneven| (now.0 as u32).wrapping_sub(uneven.of.end()).cast_signed();
            if place.as_ref().is_some_and(|uneven| pauses || ago(uneven) > HORIZON.cast_signed()) {
                *place = None;
            }
        }
    }

    /// `pulses` of this direction were rendered last, from the tick `begin` on, and not played. Returns how many of them push.
    pub(super) fn undo(&mut self, direction: Direction, pulses: u16, begin: u32) -> u16 {
        let mut uneven = self.uneven.iter().flatten();
        let within = uneven.find(|uneven| begin.wrapping_sub(uneven.of.start) < uneven.of.pulses.into());
        match (within, direction) {
            (Some(&Uneven { of, from }), _) => {
                let end = begin.wrapping_add(pulses.into());
                let [left, undone] = [begin, end].map(|now| of.until(from, now));
                self.height = left.to;
                self.go_below(left.below(from).saturating_sub(undone.below(from)));
                return undone.pushes - left.pushes;
            }
            (None, Direction::Up) => self.height = self.height.saturating_sub(pulses),
            (None, Direction::Down) => self.height = self.height.saturating_add(pulses),
        }
        0
    }

    /// How many of `pulses` down push against a lower stop.
    pub(super) fn pushes(&self, pulses: u16) -> u16 {
        pulses.saturating_sub(self.height.saturating_sub(self.left_to_push()))
    }

    /// Forgets the bursts so far: none of their ticks is taken back any more.
    pub(super) fn forget_bursts(&mut self) {
        self.uneven = [None; UNEVEN];
    }
}
