//! Plays strokes: queues them, renders the lines from them, and books what was played.
//!
//! It knows neither the state nor the pins. The parts above say when strokes are cut, and learn what a cut leaves of each.
//!
//! | module | what it does |
//! |---|---|
//! | `pool` | holds the strokes, a queue for each motor |
//! | `strokes` | judges, queues, withdraws and amends strokes of plays |
//! | `drive` | queues bursts that belong to no play |
//! | `lines`, `changes` | render the lines, and know which line changes next |
//! | `drivers` | enables the drivers around bursts |
//! | `marks` | passes marks, and gives the trigger output |
//! | `completion` | books what was played, cuts strokes, turns all off |
//! | `allowance`, `density`, `at_once` | keep the limits on what begins, and on motors at once |
//!
//! Invariant: the lines follow from the queued slots alone, and a slot changes only ahead of the rendered end. So the
//! number of pulses played is known after any cut, flush or amendment.

mod allowance;
mod at_once;
mod changes;
mod completion;
mod density;
mod drive;
mod drivers;
mod lines;
mod marks;
mod pool;
mod strokes;

use crate::array::Layout;
use crate::controller::reporting::Reporting;
use crate::limits::PowerLimits;
use crate::message::Trigger;
use crate::stroke::Lines;
use crate::tick::Tick;
use allowance::Allowance;
use changes::Changes;
pub(super) use completion::Left;
use core::hash::{Hash, Hasher};
pub use drivers::DRIVER_TAIL;
use drivers::Drivers;
use marks::Marks;
pub(super) use pool::Kind;
pub use pool::POOL;
use pool::{Pool, Slot};

/// A tick that does not come.
pub(super) const NEVER: Tick = Tick(u64::MAX);

/// In this order, what rendering uses most lies where the chip's short loads reach it.
#[derive(Clone, Debug)]
#[repr(C)]
pub(super) struct Player {
    /// The first tick not rendered yet.
    rendered: Tick,
    /// No stroke ends before this tick.
    next_end: Tick,
    lines: Lines,
    drivers: Drivers,
    changes: Changes,
    marks: Marks,
    layout: Layout,
    allowance: Allowance,
    pool: Pool,
}

impl Hash for Player {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let Self { rendered, next_end, lines, drivers, changes, marks, allowance, layout: _, pool } = self;
        let Drivers { since, tail_end, lead: _ } = drivers;
        (since, (*tail_end).max(*rendered), rendered, next_end, lines).hash(hasher);
        (changes, marks, allowance, pool).hash(hasher);
    }
}

impl Player {
    /// Nothing is queued, and nothing rendered before `now`.
    pub(super) const fn new(layout: Layout, now: Tick) -> Self {
        Self {
            rendered: now,
            next_end: NEVER,
            lines: Lines::OFF,
            drivers: Drivers::new(&layout),
            changes: Changes::none(now),
            marks: Marks::NONE,
            allowance: Allowance::new(&layout, now),
            pool: Pool::new(&layout),
            layout,
        }
    }

    pub(super) fn rendered(&self) -> Tick {
        self.rendered
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pool.is_empty()
    }

    /// Number of queued strokes of `motor`.
    pub(super) fn len(&self, motor: u8) -> u16 {
        self.pool.len(motor.into())
    }

    /// Stroke slots that the host may fill. Each refused stroke takes one until the host has seen its report: so there
    /// is always a place for the next report.
    pub(super) fn credits(&self, reporting: &Reporting) -> u16 {
        self.pool.free().saturating_sub(reporting.reports().refused())
    }

    /// The layout of the array.
    pub(super) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Sets the limits of an arming; the array's own apply, too. The pulses counted so far stay.
    pub(super) fn set_limits(&mut self, limits: PowerLimits, pushes_per_s: u32) {
        let limits = self.layout.no_limits().min(limits);
        self.allowance.set_limits(limits, pushes_per_s, &self.layout);
    }

    pub(super) fn limits(&self) -> PowerLimits {
        self.allowance.limits()
    }

    /// Whether the pins have a lower stop that they may push against.
    pub(super) fn has_stop(&self) -> bool {
        self.allowance.has_stop()
    }

    /// Whether one more mark may wait.
    pub(super) fn takes_mark(&self) -> bool {
        !self.marks.is_full()
    }

    /// Queues a mark. There was room when its frame was read.
    pub(super) fn push_mark(&mut self, at: Tick, trigger: Option<Trigger>) {
        self.marks.push(at, trigger);
    }

    /// Forgets the marks that have not passed.
    pub(super) fn forget_marks(&mut self) {
        self.marks.clear();
    }

    fn queue(&mut self, slot: Slot) -> bool {
        let motor = usize::from(slot.stroke.motor);
        let idle = self.pool.current(motor).is_none();
        let queued = self.pool.push(slot);
        if idle && queued {
            // The line may not have been brought to the rendered end since its last stroke ended.
            self.change_by(motor, slot.stroke.up);
        }
        self.next_end = self.next_end.min(slot.stroke.end());
        queued
    }
}
