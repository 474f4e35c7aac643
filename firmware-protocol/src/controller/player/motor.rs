//! What one motor does: how high its pin is, how high it should be, and the burst that runs.
//!
//! Limits are not here: the player asks them before a burst begins.
//!
//! Invariant: while no burst runs, `height` is where the pin is. Within a burst it counts the pulses that were played; at its end the pin is
//! where the burst was to bring it, because a correction is no height.

use crate::stroke::Direction;
use crate::tick::Tick;
use core::hash::{Hash, Hasher};

/// A burst that runs. Ticks are low halves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Running {
    pub(super) direction: Direction,
    start: u32,
    pub(super) pulses: u16,
    /// The height at its end.
    to: u16,
    /// How many of its last pulses push against the lower stop.
    pub(super) pushes: u16,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Motor {
    /// Where the pin is, or where the running burst began.
    pub(super) height: u16,
    /// The level that the pin should have.
    goal: u16,
    pub(super) running: Option<Running>,
    /// For the way down to the goal: the pulses that an amendment adds, and the surplus.
    pub(super) correction: i16,
    pub(super) surplus: u16,
    /// When the last burst ended.
    pub(super) still_since: Tick,
}

impl Hash for Motor {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let Self { height, goal, running, correction, surplus, still_since } = self;
        (height, goal, running, correction, surplus).hash(hasher);
        if *height > 0 {
            still_since.hash(hasher);
        }
    }
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
}

impl Motor {
    pub(super) const REST: Self =
        Self { height: 0, goal: 0, running: None, correction: 0, surplus: 0, still_since: Tick(0) };

    pub(super) const fn goal(&self) -> u16 {
        self.goal
    }

    /// Pulses above rest at the tick `now`.
    pub(super) fn height(&self, now: u32) -> u16 {
        let Some(running) = self.running else { return self.height };
        let played = running.played(now);
        match running.direction {
            _ if played == running.pulses => running.to,
            Direction::Up => self.height.saturating_add(played),
            Direction::Down => self.height.saturating_sub(played).max(running.to),
        }
    }

    /// Whether its pin is above its goal and no burst runs.
    pub(super) const fn is_to_descend(&self) -> bool {
        self.running.is_none() && self.height > self.goal
    }

    /// Whether no burst runs and the pin is where it should be.
    pub(super) const fn is_still(&self) -> bool {
        self.running.is_none() && self.height == self.goal
    }

    /// Ends the burst that runs, at `now`.
    pub(super) fn end(&mut self, now: Tick) -> Option<Running> {
        let ended = self.running?;
        self.height = self.height(now.0 as u32);
        (self.running, self.still_since) = (None, now);
        Some(ended)
    }

    /// Where the pin is, and where it should be, without a burst.
    pub(super) fn place(&mut self, height: u16, goal: u16) {
        *self = Self { height, goal, still_since: self.still_since, ..Self::REST };
    }

    /// The pin should have this level. A burst to another one has been ended.
    pub(super) fn set_goal(&mut self, level: u16) {
        (self.goal, self.correction, self.surplus) = (level, 0, 0);
    }

    /// Begins a burst at `now`, after which the pin has the height `to`.
    pub(super) fn begin(&mut self, now: Tick, direction: Direction, pulses: u16, pushes: u16, to: u16) {
        self.running = Some(Running { direction, start: now.0 as u32, pulses, to, pushes });
    }

    /// `pulses` of this direction were rendered last, and not played.
    pub(super) fn undo(&mut self, direction: Direction, pulses: u16) {
        self.height = match direction {
            Direction::Up => self.height.saturating_sub(pulses),
            Direction::Down => self.height.saturating_add(pulses),
        };
    }
}
