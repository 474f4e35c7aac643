//! Plays moves: queues them, renders the lines from them, and counts what was played.
//!
//! It judges, queues, withdraws and amends the moves of plays. It does not know the state: the parts above say when pins come down.
//!
//! | module | what it does |
//! |---|---|
//! | `queue` | holds the moves that have not begun, a queue for each motor |
//! | `motor` | knows how high a pin is and should be, and the burst that runs |
//! | `lines`, `changes` | render the lines, and know which line changes next |
//! | `drivers` | enables the drivers around bursts |
//! | `marks` | passes marks, and gives the trigger output |
//! | `cut`, `recent` | bring pins down, turn all off and take back what was not played |
//! | `allowance`, `density` | keep the limits on what begins |
//!
//! Invariant: what is rendered stays, and follows from the queues and the motors: they change only from the rendered end on. A move is
//! queued behind all others of its motor, withdrawn only as long as it has not begun, and amended only ahead of the rendered end.

mod allowance;
mod changes;
mod cut;
mod density;
mod drivers;
mod lines;
mod marks;
mod motor;
mod queue;
mod recent;

use crate::array::{CAPACITY, Layout, MotorSet};
use crate::batch::Amendment;
use crate::controller::reporting::Reporting;
use crate::controller::session::newer;
use crate::limits::{self, PowerLimits, Refusal};
use crate::message::Mark;
use crate::moves::Move;
use crate::stroke::Lines;
use crate::tick::Tick;
use allowance::Allowance;
use changes::Changes;
use core::hash::{Hash, Hasher};
use core::task::{Poll, ready};
pub use drivers::DRIVER_TAIL;
use drivers::Drivers;
pub use lines::Run;
use marks::Marks;
use motor::Motor;
pub use queue::POOL;
use queue::{Queues, Waiting, follow};
use recent::Recent;

/// Most ticks from now to a move.
const FARTHEST: i64 = 1 << 30;

/// A burst up that shifts where a pin rests.
#[derive(Clone, Copy, Debug, Hash)]
struct Shifting {
    motor: u8,
    pulses: u16,
    /// The first tick after its last pulse, once it has begun.
    end: Option<Tick>,
}

/// How long pins may stay above rest.
#[derive(Clone, Copy, Debug)]
struct Hold {
    /// For how many ticks a pin may stay there without a pulse. `None`: for as long as the lines are off.
    most: Option<u32>,
    /// When that was last checked.
    checked: u32,
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

impl Hash for Lowered {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let from = (!self.is_empty()).then_some(self.from);
        (self.late, self.held, from).hash(hasher);
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
    hold: Hold,
    layout: Layout,
    recent: Recent,
    allowance: Allowance,
    queues: Queues,
}

impl Hash for Player {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let Self {
            rendered,
            still_from,
            lines,
            drivers,
            changes,
            motors,
            marks,
            lowered,
            shifting,
            hold,
            ..
        } = self;
        let Drivers { since, tail_end, lead: _ } = drivers;
        (since, (*tail_end).max(*rendered), rendered, (*still_from).max(*rendered), lines).hash(hasher);
        (changes, motors, marks, lowered, shifting, hold.most).hash(hasher);
        (&self.recent, &self.allowance, &self.queues).hash(hasher);
    }
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
            hold: Hold { most: None, checked: now.0 as u32 },
            recent: Recent::NOTHING,
            allowance: Allowance::new(&layout, now),
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
    pub(super) fn push_mark(&mut self, at: Tick, mark: &Mark) {
        self.marks.push(at, mark.trigger);
    }

    /// For how long pins may be held from now on, ticks.
    pub(super) fn set_hold(&mut self, hold: u32) {
        self.hold.most = Some(hold.clamp(self.layout.least_hold(), self.layout.longest_hold()));
    }

    /// Forgets the marks that have not passed.
    pub(super) fn forget_marks(&mut self) {
        self.marks.clear();
    }

    /// The first tick at which a burst that is queued now may begin.
    pub(in crate::controller) fn ready(&self) -> Tick {
        self.drivers.ready(self.rendered)
    }

    /// Judges a move by itself. `Ok(false)` if it is late.
    pub(in crate::controller) fn judge(&self, to: &Move, now: Tick) -> Result<bool, Refusal> {
        self.layout.check(to)?;
        // Its level counts from where the pin rests when the shift is over.
        if self.shifting.is_some_and(|of| of.motor == to.motor) {
            return Err(Refusal::State);
        }
        if to.surplus > 0 && !self.has_stop() {
            return Err(Refusal::Pushing);
        }
        if to.tick >= self.ready() && to.tick.since(now) > FARTHEST {
            return Err(Refusal::TooFar);
        }
        Ok(to.tick >= self.ready())
    }

    /// Whether moves may be queued behind the others of their motor: each at least [`Layout::least_apart`](crate::array::Layout::least_apart)
    /// after the last but one before it, and as many as there are credits.
    pub(in crate::controller) fn takes(&self, moves: &[Move], reporting: &Reporting) -> Result<(), Refusal> {
        if usize::from(self.credits(reporting)) < moves.len() {
            return Err(Refusal::PoolFull);
        }
        let Some(first) = moves.first() else { return Ok(()) };
        let ticks = self.queues.last_ticks(first.motor.into());
        if follow(moves, ticks, self.least_apart) { Ok(()) } else { Err(Refusal::Dense) }
    }

    /// Queues a move, or the two of a stroke. They take only amendments newer than `generation`. A move to rest has been played if the pin is at
    /// rest by then, whatever is refused before: it would enable the drivers for no pulse.
    pub(in crate::controller) fn append(
        &mut self,
        moves: &[Move],
        generation: Option<u16>,
        reporting: &mut Reporting,
    ) {
        let Some(&Move { motor, tick: begin, .. }) = moves.first() else { return };
        let motor = usize::from(motor);
        let last = self.queues.last(motor);
        let mut from = last.map_or(self.motors[motor].goal(), |last| last.level);
        // A stroke that is refused leaves the goal of the move before it.
        let rests = from == 0 && !last.is_some_and(|last| last.joined);
        if rests && moves.iter().all(|to| to.level == 0 && to.surplus == 0) {
            reporting.count().played += moves.len() as u64;
            return;
        }
        let first = self.queues.first(motor).is_none();
        for (&Move { tick, level, surplus, .. }, joined) in moves.iter().zip([false, true]) {
            let low = tick.0 as u32;
            let waiting = Waiting { tick: low, level, surplus, from, generation, joined, ..Waiting::NOTHING };
            let _ = self.queues.push(motor, tick, waiting);
            from = level;
        }
        if first {
            self.change_by(motor, begin);
        }
    }

    /// A move that is late: of a lower level it is the goal from now on.
    pub(in crate::controller) fn late(&mut self, to: &Move) {
        // A move of the motor that has begun since is newer.
        if self.queues.begun(to.motor.into()) < to.tick {
            self.lower_by_late(to.motor.into(), to.level);
        }
    }

    /// Withdraws the moves of `motor` from `from` on, and returns their number. `None`, and all of them stay, if one of them has begun, or
    /// if the moves of `next` come too shortly after those before them. Pending: it has searched past as many moves as it may, `steps`; the next
    /// call goes on.
    pub(in crate::controller) fn withdraw(
        &mut self,
        motor: u8,
        from: Tick,
        next: &[Move],
        steps: &mut u16,
    ) -> Poll<Option<u16>> {
        let motor = usize::from(motor);
        let withdrawn = self.queues.withdraw(motor, from, next, self.least_apart, self.rendered, steps);
        let Poll::Ready(Some(moves)) = withdrawn else { return withdrawn };
        let is_low = !self.lines.pulsing().contains(motor as u8);
        if self.queues.first(motor).is_none() && self.motors[motor].is_still() && is_low {
            // The line waits for the withdrawn move no longer, nor do the drivers. One whose burst has just been ended is still to fall.
            self.changes.forget(motor);
        }
        Poll::Ready(Some(moves))
    }

    /// Changes the number of pulses of a move that is not rendered yet. Returns `false` if the amendment is ignored. Pending: as in
    /// [`Self::withdraw`].
    pub(in crate::controller) fn amend(
        &mut self,
        generation: u16,
        item: &Amendment,
        steps: &mut u16,
    ) -> Poll<bool> {
        let (now, has_stop) = (self.rendered, self.has_stop());
        let found = ready!(self.queues.find(item.motor.into(), item.tick, now, steps));
        let Some((waiting, next)) = found else { return Poll::Ready(false) };
        let planned = waiting.level.abs_diff(waiting.from);
        let is_up = waiting.level > waiting.from;
        let most = if is_up { self.layout.max_up_pulses() } else { self.layout.max_down_pulses() };
        let room = next.map_or(u32::MAX, |next| next.wrapping_sub(waiting.tick));
        let fits = planned > 0
            && limits::within_correction(planned, item.pulses)
            && u32::from(item.pulses) <= room
            && (1..=most).contains(&item.pulses)
            // With a stop, what goes down further than planned would push.
            && (is_up || !has_stop || item.pulses <= planned);
        let newest = waiting.generation.is_none_or(|old| newer(generation, old));
        if fits && newest {
            waiting.generation = Some(generation);
            waiting.correction = item.pulses.cast_signed() - planned.cast_signed();
        }
        Poll::Ready(fits && newest)
    }
}
