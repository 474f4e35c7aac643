//! Plays moves: queues them, renders the lines from them, and counts what was played.
//!
//! It does not know the state. The parts above say when pins come down.
//!
//! | module | what it does |
//! |---|---|
//! | `queue` | holds the moves that have not begun, a queue for each motor |
//! | `motor` | knows how high a pin is and should be, and the burst that runs |
//! | `moves` | judges, queues, withdraws and amends moves of plays |
//! | `lines`, `changes` | render the lines, and know which line changes next |
//! | `drivers` | enables the drivers around bursts |
//! | `marks` | passes marks, and gives the trigger output |
//! | `cut`, `recent` | bring pins down, turn all off and take back what was not played |
//! | `density` | bounds how many moves begin; [`limits`](crate::limits) count their pulses |
//!
//! Invariant: what is rendered follows from the queues and the motors, and they change only from the rendered end on.

mod changes;
mod cut;
mod density;
mod drivers;
mod lines;
mod marks;
mod motor;
mod moves;
mod queue;
mod recent;

use crate::array::{CAPACITY, Layout, MotorSet};
use crate::controller::reporting::Reporting;
use crate::limits::{OnTime, PowerLimits, Pushing};
use crate::message::Mark;
use crate::stroke::Lines;
use crate::tick::Tick;
use changes::Changes;
use density::Density;
pub use drivers::DRIVER_TAIL;
use drivers::Drivers;
use marks::Marks;
use motor::Motor;
pub use queue::POOL;
use queue::Queues;
use recent::Recent;

/// A tick that does not come.
pub(super) const NEVER: Tick = Tick(u64::MAX);

/// A burst up that shifts where a pin rests.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shifting {
    pub(super) motor: u8,
    pub(super) pulses: u16,
    /// The first tick after its last pulse, once it has begun.
    end: Option<Tick>,
}

/// Motors whose goals the device has lowered by itself.
#[derive(Clone, Copy, Debug)]
struct Lowered {
    /// By a late move, and because the pin was held for too long.
    late: MotorSet,
    held: MotorSet,
    /// The first tick in which it may have done so.
    from: Tick,
}

impl Lowered {
    const NOTHING: Self = Self { late: MotorSet::EMPTY, held: MotorSet::EMPTY, from: Tick(0) };

    fn is_empty(&self) -> bool {
        (self.late | self.held).is_empty()
    }
}

/// In this order, what rendering uses most lies where the chip's short loads reach it.
#[derive(Clone, Debug)]
#[repr(C)]
pub(super) struct Player {
    /// The first tick not rendered yet.
    rendered: Tick,
    /// When the last burst ended or will end that was rendered.
    still_from: Tick,
    lines: Lines,
    /// Whether the limits on motors at once make some wait for others.
    takes_turns: bool,
    /// [`Layout::least_apart`], which costs a division.
    least_apart: u32,
    drivers: Drivers,
    changes: Changes,
    motors: [Motor; CAPACITY],
    marks: Marks,
    /// What the device has lowered since the last report of that.
    lowered: Lowered,
    /// The last shift of rest upwards, until it is over.
    shifting: Option<Shifting>,
    /// For how many ticks a pin may stay above rest without a pulse, and when that was last checked. `None`: for as long as the lines are off.
    hold: Option<u32>,
    hold_checked: u32,
    layout: Layout,
    recent: Recent,
    density: Density,
    on_time: OnTime,
    pushing: Pushing,
    queues: Queues,
}

impl Player {
    /// Nothing is queued, and nothing rendered before `now`.
    pub(super) const fn new(layout: Layout, now: Tick) -> Self {
        Self {
            rendered: now,
            still_from: now,
            lines: Lines::OFF,
            takes_turns: false,
            least_apart: layout.least_apart(),
            drivers: Drivers::new(&layout),
            changes: Changes::none(now),
            motors: [Motor::REST; CAPACITY],
            marks: Marks::NONE,
            lowered: Lowered::NOTHING,
            shifting: None,
            hold: None,
            hold_checked: now.0 as u32,
            recent: Recent::NOTHING,
            density: Density::new(&layout),
            on_time: OnTime::new(&layout, now),
            pushing: Pushing::new(&layout, now),
            queues: Queues::new(),
            layout,
        }
    }

    pub(super) fn rendered(&self) -> Tick {
        self.rendered
    }

    /// Whether no move waits.
    pub(super) fn is_empty(&self) -> bool {
        self.queues.is_empty()
    }

    /// Slots that the host may fill. Each refused move takes one until the host has seen its report: so there is always a place for the next
    /// report.
    pub(super) fn credits(&self, reporting: &Reporting) -> u16 {
        self.queues.free().saturating_sub(reporting.reports().refused())
    }

    /// The layout of the array.
    pub(super) fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Sets the limits of an arming; the array's own apply, too. The pulses counted so far stay.
    pub(super) fn set_limits(&mut self, limits: PowerLimits, pushes_per_s: u32) {
        let limits = self.layout.no_limits().min(limits);
        self.takes_turns = self.layout.takes_turns(&limits);
        self.pushing.set_limit(pushes_per_s);
        self.on_time.set_limits(limits, &self.layout);
    }

    pub(super) fn limits(&self) -> PowerLimits {
        self.on_time.limits()
    }

    /// Whether the pins have a lower stop that they may push against.
    pub(super) fn has_stop(&self) -> bool {
        self.pushing.is_allowed()
    }

    /// Whether one more mark may wait.
    pub(super) fn takes_mark(&self) -> bool {
        !self.marks.is_full()
    }

    /// Queues a mark. There was room when its frame was read.
    pub(super) fn push_mark(&mut self, at: Tick, mark: &Mark, begins_play: bool) {
        self.marks.push(at, mark.trigger, begins_play.then_some(mark.hold));
    }

    /// For how long pins may be held from now on, ticks.
    pub(super) fn set_hold(&mut self, hold: u32) {
        let _ = self.marks.take_hold();
        self.hold = Some(hold.clamp(self.layout.least_hold(), self.layout.longest_hold()));
    }

    /// Forgets the marks that have not passed.
    pub(super) fn forget_marks(&mut self) {
        self.marks.clear();
    }
}
