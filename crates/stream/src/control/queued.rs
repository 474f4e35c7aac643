//! A burst that was sent to the device and is not over: what was planned, and what position control made of it.

use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::strokes::{Burst, Step};

/// A burst sent to the device and not over yet. Small: many thousands may be queued.
#[derive(Clone, Copy, Debug)]
pub(super) struct Queued {
    pub(super) motor: u8,
    /// As corrected.
    pub(super) burst: Burst,
    /// Pulses planned, with the surplus.
    pub(super) planned: u16,
    /// Planned pulses after the pin is at rest, against the lower stop.
    pub(super) surplus: u16,
    /// Pulses above rest after it.
    pub(super) level: u16,
    /// The second burst of a stroke: the device takes and withdraws it with the one before.
    pub(super) joined: bool,
    pub(super) accepted: bool,
    pub(super) closed_loop: bool,
    /// Tenths of pulses that it adds to `pending`, once finalised.
    pub(super) counted: i64,
    /// For the telemetry monitor: the correction, which counts once the device has played it.
    pub(super) correction: Option<Correction>,
    /// The end of its play: no correction may cross it.
    pub(super) until: Tick,
}

/// A correction as the telemetry monitor judges it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Correction {
    /// By how much, if a limit cut it, µm.
    pub(super) limited_um: Option<f32>,
    /// The estimated rest position at that time, µm.
    pub(super) rest_um: f32,
}

/// When the device cut what it played, and when the pins were back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cutting {
    /// The first tick in which nothing of the queue was played.
    pub(crate) at: Tick,
    /// When the last pulse of the return was over; after an e-stop or a fault there is none.
    pub(crate) returned: Option<Tick>,
}

/// Too many moves have begun since to know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Forgotten;

impl Queued {
    /// Fills memory before there are bursts.
    pub(super) const NOTHING: Self = Self {
        motor: 0,
        burst: Burst { start: Tick(0), direction: Direction::Up, pulses: 0 },
        planned: 0,
        surplus: 0,
        level: 0,
        joined: false,
        accepted: false,
        closed_loop: false,
        counted: 0,
        correction: None,
        until: Tick(0),
    };

    /// The bursts of a step that was sent; its play ends at `until`.
    pub(super) fn of(step: &Step, closed_loop: bool, until: Tick) -> impl Iterator<Item = Self> + use<> {
        let (motor, step) = (step.motor(), *step);
        step.bursts().zip([false, true]).map(move |(burst, joined)| {
            let planned = burst.pulses;
            let (level, surplus) = match step {
                Step::Stroke(stroke) if !joined => (stroke.up_pulses, 0),
                _ => (step.level(), step.surplus()),
            };
            Self { motor, burst, planned, surplus, level, joined, closed_loop, until, ..Self::NOTHING }
        })
    }

    /// Whether its pin is at rest after it.
    pub(super) const fn lands(&self) -> bool {
        self.level == 0
    }

    /// The level before it, pulses above rest.
    pub(super) const fn level_before(&self) -> u16 {
        let way = self.planned.saturating_sub(self.surplus);
        match self.burst.direction {
            Direction::Up => self.level.saturating_sub(way),
            Direction::Down => self.level.saturating_add(way),
        }
    }

    /// The level at a tick that is not before its beginning: a correction is no height.
    pub(super) fn level_at(&self, tick: Tick) -> u16 {
        let played = u16::try_from(tick - self.burst.start).unwrap_or(u16::MAX);
        match self.burst.direction {
            _ if played >= self.burst.pulses => self.level,
            Direction::Up => self.level_before().saturating_add(played).min(self.level),
            Direction::Down => self.level_before().saturating_sub(played).max(self.level),
        }
    }

    /// It begins at another level than planned: it goes to its own all the same.
    pub(super) fn begin_at(&mut self, level: u16) {
        self.burst.direction = if self.level > level { Direction::Up } else { Direction::Down };
        self.planned = self.level.abs_diff(level) + self.surplus;
        self.burst.pulses = self.planned;
    }
}
