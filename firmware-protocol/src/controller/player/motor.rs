//! What one motor does: how high its pin is, how high it should be, and the burst that runs.
//!
//! A pin goes up only by a move. It comes down whenever it is above its goal. Limits are not here: the caller asks them before a burst
//! begins.
//!
//! Invariant: while no burst runs, `height` is where the pin is; within a burst it counts the pulses that were played.

use crate::stroke::Direction;

/// A burst that runs. Ticks are low halves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Running {
    pub(super) direction: Direction,
    start: u32,
    pulses: u16,
    /// The height at its end, whatever correction it has.
    to: u16,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Motor {
    /// Where the running burst began, or where the pin is.
    height: u16,
    /// The level that the pin should have.
    goal: u16,
    running: Option<Running>,
}

impl Running {
    /// The low half of the first tick after its last pulse.
    pub(super) const fn end(&self) -> u32 {
        self.start.wrapping_add(self.pulses as u32)
    }

    /// Pulses before the tick `now`.
    fn played(&self, now: u32) -> u16 {
        let passed = now.wrapping_sub(self.start).cast_signed().max(0);
        u16::try_from(passed).map_or(self.pulses, |passed| passed.min(self.pulses))
    }
}

impl Motor {
    pub(super) const REST: Self = Self { height: 0, goal: 0, running: None };

    pub(super) const fn goal(&self) -> u16 {
        self.goal
    }

    pub(super) const fn running(&self) -> Option<Running> {
        self.running
    }

    /// Pulses above rest at the tick `now`.
    pub(super) fn height(&self, now: u32) -> u16 {
        let Some(running) = self.running else { return self.height };
        let played = running.played(now);
        match running.direction {
            _ if played == running.pulses => running.to,
            Direction::Up => self.height.saturating_add(played),
            Direction::Down => self.height.saturating_sub(played),
        }
    }

    /// Ends the burst that runs, if one does, at `now`. Returns the pulses of it that are left.
    pub(super) fn end(&mut self, now: u32) -> u16 {
        let left = self.running.map_or(0, |running| running.pulses - running.played(now));
        (self.height, self.running) = (self.height(now), None);
        left
    }

    /// Lowers the goal. A burst up that runs beyond it must be ended by the caller.
    pub(super) fn lower_to(&mut self, level: u16) {
        self.goal = self.goal.min(level);
    }

    /// A level is asked for: the goal, if no burst up is needed or one may begin.
    pub(super) fn set_goal(&mut self, level: u16) {
        self.goal = level;
    }

    /// The way to the goal: direction and pulses. `None` if the pin is there.
    pub(super) fn way(&self) -> Option<(Direction, u16)> {
        match self.goal.cmp(&self.height) {
            core::cmp::Ordering::Equal => None,
            core::cmp::Ordering::Greater => Some((Direction::Up, self.goal - self.height)),
            core::cmp::Ordering::Less => Some((Direction::Down, self.height - self.goal)),
        }
    }

    /// Begins a burst of `pulses` to the goal at `now`. None runs.
    pub(super) fn begin(&mut self, now: u32, direction: Direction, pulses: u16) {
        self.running = Some(Running { direction, start: now, pulses, to: self.goal });
    }

    /// After an e-stop: `undone` pulses in this direction were rendered and not played.
    pub(super) fn undo(&mut self, direction: Direction, undone: u16) {
        self.height = match direction {
            Direction::Up => self.height.saturating_sub(undone),
            Direction::Down => self.height.saturating_add(undone),
        };
        self.goal = self.height;
    }
}
