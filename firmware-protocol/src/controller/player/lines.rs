//! Renders the lines: lets moves begin in their tick, bursts run, and pins come down that are above their goal.
//!
//! [`Player::render`] looks at a line only when it changes, and computes in 32 bits where it can: it takes most of the chip's time.
//!
//! Invariant: a pin goes up only by a move that begins in its tick. It comes down whenever it is above its goal, as soon as the drivers are
//! ready and the limits on motors at once allow it.

use crate::array::{MotorSet, Ring};
use crate::controller::Run;
use crate::controller::player::queue::{Waiting, ahead};
use crate::controller::player::recent::{Begun, Rendered};
use crate::controller::player::{Lowered, NEVER, Player};
use crate::controller::reporting::Reporting;
use crate::limits::Refusal;
use crate::message::Report;
use crate::stroke::Direction;
use crate::tick::{Tick, WireTick};

/// How often the time is checked for which pins are held, ticks; a power of 2.
const HOLD_CHECKS: u32 = 1024;

impl Player {
    /// Renders the outputs from the rendered end on, for `max` ticks or until one changes.
    pub(in crate::controller) fn render(&mut self, max: u32, reporting: &mut Reporting) -> Run {
        if max == 0 {
            // Do not bring lines to a tick that is not rendered: a move in it can still be amended.
            return Run { lines: self.lines, trigger: false, drivers: false, ticks: 0 };
        }
        let (trigger, change) = self.marks.level(self.rendered, reporting.count());
        let now = self.rendered.0 as u32;
        if self.changes.is_over(now) {
            self.next_block(now, reporting);
        }
        let before = Begun::of(reporting.count());
        for (mut due, first) in self.changes.take(now).parts().into_iter().zip((0..).step_by(32)) {
            while due != 0 {
                // A multiplication and a table on the chip.
                self.step(first + due.trailing_zeros() as usize, reporting);
                due &= due - 1;
            }
        }
        let ticks = self.changes.quiet(now).min(max);
        let ticks = if change == NEVER { ticks } else { (change - self.rendered).min(ticks.into()) as u32 };
        let (drivers, ticks) = self.enable_drivers(ticks);
        self.rendered = self.rendered + u64::from(ticks);
        let counters = reporting.count();
        // At most a block.
        counters.pulses += u64::from(self.lines.pulsing().len() * ticks);
        let (lines, begun) = (self.lines, Begun::of(counters).since(before));
        self.recent.push(Rendered { lines, ticks, begun });
        Run { lines, trigger, drivers, ticks }
    }

    #[inline(never)]
    fn next_block(&mut self, now: u32, reporting: &mut Reporting) {
        self.changes.open(now);
        // What counts no longer is dropped here, and not when a move begins: after a rest that would be the pulses of a whole second at
        // once.
        self.density.next_block();
        self.on_time.pulses.pass(self.rendered);
        self.pushing.pulses.pass(self.rendered);
        if now.wrapping_sub(self.hold_checked) >= HOLD_CHECKS {
            self.hold_checked = now;
            self.end_holds();
        }
        // If there is no place, the next ones join it.
        if !self.lowered.is_empty() && reporting.reports().has_room() {
            let Lowered { late, held, from } = core::mem::replace(&mut self.lowered, Lowered::NOTHING);
            reporting.report(Report::Lowered { tick: from.wire(), late, held });
        }
    }

    /// Brings down the pins that have been held for too long.
    fn end_holds(&mut self) {
        if let Some(hold) = self.marks.take_hold() {
            self.set_hold(hold);
        }
        let Some(hold) = self.hold else { return };
        for motor in 0..self.layout.loop_end() {
            let Some(of) = self.motors.get(motor) else { break };
            if of.goal() > 0 && of.is_still() && self.rendered - of.still_since > u64::from(hold) {
                self.lower(motor, 0);
                self.lowered.held.insert(motor as u8);
            }
        }
    }

    /// A late move lowers a motor's goal, now.
    pub(super) fn lower_by_late(&mut self, motor: usize, level: u16) {
        if self.motors[motor].goal() > level {
            self.lower(motor, level);
            self.lowered.late.insert(motor as u8);
        }
    }

    /// Lowers a motor's goal, now, because the device decides so.
    fn lower(&mut self, motor: usize, level: u16) {
        let now = self.rendered;
        if self.lowered.is_empty() {
            self.lowered.from = now;
        }
        self.end(motor);
        // A burst up that has not come so far ends here.
        let height = self.motors[motor].height;
        self.motors[motor].set_goal(level.min(height));
        self.change_by(motor, now);
    }

    /// Makes rendering look at the line of `motor` at `tick` or before.
    pub(super) fn change_by(&mut self, motor: usize, tick: Tick) {
        self.changes.by(motor, tick.max(self.rendered).0 as u32);
    }

    /// Brings the line of one motor to the rendered end.
    #[inline(never)]
    fn step(&mut self, motor: usize, reporting: &mut Reporting) {
        let now = self.rendered;
        let low = now.0 as u32;
        if self.motors[motor].running.is_some_and(|running| running.end() == low) {
            self.end(motor);
        }
        if self.queues.first(motor).is_some_and(|next| ahead(next.tick, now) <= 0) {
            self.begin_move(motor, reporting);
        }
        let looks_again = if self.motors[motor].is_to_descend() {
            self.descend(motor)
        } else if self.is_to_shift(motor) {
            self.begin_shift(motor)
        } else {
            None
        };
        let bit = MotorSet::of(motor);
        self.lines.up = self.lines.up.without(bit);
        self.lines.down = self.lines.down.without(bit);
        let mut next = looks_again;
        if let Some(running) = self.motors[motor].running {
            *self.lines.set_mut(running.direction) |= bit;
            next = Some(running.end());
        }
        if let Some(waiting) = self.queues.first(motor)
            && next.is_none_or(|next| waiting.tick.wrapping_sub(next).cast_signed() < 0)
        {
            next = Some(waiting.tick);
        }
        match next {
            Some(next) => self.changes.next(motor, next),
            None => self.changes.forget(motor),
        }
    }

    /// Ends the burst that runs, at the rendered end.
    #[inline(never)]
    pub(super) fn end(&mut self, motor: usize) {
        let now = self.rendered;
        let Some((begun, played)) = self.motors[motor].end(now) else { return };
        self.on_time.pulses.end(motor, begun.pulses.into(), played.pulses.into());
        if begun.pushes > 0 {
            self.pushing.pulses.end(motor, begun.pushes.into(), played.pushes.into());
        }
        self.still_from = now;
        if begun.end() != now.0 as u32 {
            self.make_room(motor);
        }
    }

    /// A burst has ended early: pins of the rail that wait need wait no longer.
    #[inline(never)]
    fn make_room(&mut self, motor: usize) {
        let mut other = usize::from(self.layout.next_on_rail()[motor]);
        while other != motor {
            if self.motors[other].is_to_descend() {
                // The lines of this tick are being looked at already.
                self.change_by(other, self.rendered + 1);
            }
            other = self.layout.next_on_rail()[other].into();
        }
    }

    /// The next move of a motor sets its goal, in its tick.
    #[inline(never)]
    fn begin_move(&mut self, motor: usize, reporting: &mut Reporting) {
        let now = self.rendered;
        let before = self.motors[motor].goal();
        let Some(waiting) = self.queues.begin(motor, now) else { return };
        let Waiting { level, surplus, from, tick, correction, .. } = waiting;
        if level == before && surplus == 0 {
            // The pin is there, or on its way.
            reporting.count().played += 1;
            self.density.count();
            return;
        }
        if self.motors[motor].running.is_some() {
            self.end(motor);
        }
        let of = &mut self.motors[motor];
        let height = of.height;
        of.set_goal(level);
        // A correction is for the distance that was planned.
        let correction = if from == height { correction } else { 0 };
        let correction = if correction < 0 && level > height && self.has_stop() {
            self.without_pushes(motor, correction)
        } else {
            correction
        };
        let of = &mut self.motors[motor];
        let counters = reporting.count();
        counters.played += 1;
        if height != before {
            counters.shortened += 1;
        }
        if correction != 0 {
            counters.amended += 1;
        }
        if level <= height {
            (of.correction, of.surplus) = (correction, surplus);
            self.density.count();
            return;
        }
        let pulses = (level - height).saturating_add_signed(correction);
        match self.begin_up(motor, pulses) {
            Ok(()) => self.motors[motor].begin(now, Direction::Up, pulses, 0, level),
            Err(reason) => self.refuse(motor, before.min(height), tick, reason, reporting),
        }
    }

    /// What a correction of a way up to fewer pulses may be: those that it leaves for the way down push, and are limited.
    #[inline(never)]
    fn without_pushes(&mut self, motor: usize, correction: i16) -> i16 {
        let room = self.pushing.room(motor);
        let room = room.saturating_sub(self.motors[motor].left_to_push().into());
        -i16::try_from(room).map_or(-correction, |room| room.min(-correction))
    }

    /// A limit refuses the move that has just begun: the goal is what it was, or lower.
    #[inline(never)]
    fn refuse(&mut self, motor: usize, goal: u16, tick: u32, reason: Refusal, reporting: &mut Reporting) {
        self.motors[motor].set_goal(goal);
        // A stroke is refused as a whole.
        let second = u64::from(self.queues.drop_second(motor));
        let counters = reporting.count();
        (counters.played, counters.refused) = (counters.played - 1, counters.refused + 1 + second);
        reporting.report_refused(motor as u8, WireTick(tick.to_le_bytes()), reason);
    }

    /// Whether a burst up to the goal may begin; then it counts. Its way back must fit the on-time limits, too.
    #[inline(always)]
    fn begin_up(&mut self, motor: usize, pulses: u16) -> Result<(), Refusal> {
        self.density.begin()?;
        if self.takes_turns {
            self.has_turn(motor)?;
        }
        let back = if self.on_time.is_limited() { self.back(motor) } else { [0; 2] };
        self.on_time.begin(motor, pulses.into(), back, &self.layout)
    }

    /// Whether the limits on motors at once allow a way up.
    #[inline(never)]
    fn has_turn(&self, motor: usize) -> Result<(), Refusal> {
        let (rail, chip) = (self.layout.next_on_rail(), self.layout.next_on_chip());
        let limits = self.limits();
        if self.is_full(motor, rail, limits.rail_at_once, self.layout.motors_per_rail(), true) {
            return Err(Refusal::RailAtOnce);
        }
        if self.is_full(motor, chip, limits.chip_at_once, self.layout.motors_per_chip(), true) {
            return Err(Refusal::ChipAtOnce);
        }
        Ok(())
    }

    /// The pulses down that a motor at its goal and its rail still have to begin until all pins are at rest.
    fn back(&self, motor: usize) -> [u32; 2] {
        let rail = self.layout.next_on_rail();
        let own = u32::from(self.motors[motor].goal());
        let (mut of_rail, mut other) = (own, usize::from(rail[motor]));
        while other != motor {
            of_rail += u32::from(self.motors[other].back());
            other = rail[other].into();
        }
        [own, of_rail]
    }

    /// Whether as many motors of a group have pulses as may, besides `motor`. For a way up it is also full while a pin waits to come down.
    #[inline(never)]
    fn is_full(&self, motor: usize, ring: &Ring, limit: u8, size: u8, is_up: bool) -> bool {
        if limit >= size {
            return false;
        }
        let (mut busy, mut other) = (0, usize::from(ring[motor]));
        while other != motor {
            let of = &self.motors[other];
            if is_up && of.is_to_descend() {
                return true;
            }
            busy += u8::from(of.running.is_some_and(|running| running.end() != self.rendered.0 as u32));
            other = ring[other].into();
        }
        busy >= limit
    }

    /// When to look again whether a burst may begin, while the drivers are not ready or the limits on motors at once do not allow it.
    fn waits_until(&self, motor: usize) -> Option<u32> {
        let is_ready = |since: Tick| self.rendered - since >= u64::from(self.drivers.lead);
        if !self.drivers.since.is_some_and(is_ready) {
            return Some(self.ready().0 as u32);
        }
        if self.takes_turns { self.waits_for_turn(motor) } else { None }
    }

    #[inline(never)]
    fn waits_for_turn(&self, motor: usize) -> Option<u32> {
        let limits = self.limits();
        let (rail, chip) = (self.layout.next_on_rail(), self.layout.next_on_chip());
        if self.is_full(motor, rail, limits.rail_at_once, self.layout.motors_per_rail(), false) {
            return Some(self.next_end(motor, rail));
        }
        if self.is_full(motor, chip, limits.chip_at_once, self.layout.motors_per_chip(), false) {
            return Some(self.next_end(motor, chip));
        }
        None
    }

    /// Begins the way down to the goal, or returns when to look again. No limit on pulses refuses it: it leaves out what a correction and a
    /// surplus would add beyond the limit.
    #[inline(always)]
    fn descend(&mut self, motor: usize) -> Option<u32> {
        let later = self.waits_until(motor);
        if later.is_some() {
            return later;
        }
        let now = self.rendered;
        let of = &mut self.motors[motor];
        let (goal, correction) = (of.goal(), core::mem::take(&mut of.correction));
        // No burst runs.
        let distance = of.height - goal;
        let surplus = core::mem::take(&mut of.surplus);
        if correction == 0 && surplus == 0 && of.left_to_push() == 0 {
            of.begin(now, Direction::Down, distance, 0, goal);
            self.on_time.pulses.count(motor, distance.into());
            return None;
        }
        self.descend_uneven(motor, distance, correction, surplus);
        None
    }

    #[inline(never)]
    fn descend_uneven(&mut self, motor: usize, distance: u16, correction: i16, surplus: u16) {
        let (now, goal) = (self.rendered, self.motors[motor].goal());
        let mut pulses = distance.saturating_add_signed(correction.min(0)).max(distance.min(1));
        let mut pushes = if self.has_stop() { self.motors[motor].pushes(pulses) } else { 0 };
        if pushes > 0 {
            self.pushing.pulses.count(motor, pushes.into());
            pulses -= pushes;
        }
        if correction > 0 || surplus > 0 {
            let room = if self.on_time.is_limited() { self.room(motor, pulses + pushes) } else { u16::MAX };
            let more = correction.max(0).cast_unsigned().min(room);
            pulses += more;
            // Not more than the surplus.
            let surplus = u32::from(surplus.min(room - more)).min(self.pushing.room(motor)) as u16;
            self.pushing.pulses.count(motor, surplus.into());
            pushes += surplus;
        }
        if pulses + pushes > 0 {
            self.on_time.pulses.count(motor, (pulses + pushes).into());
            self.motors[motor].begin(now, Direction::Down, pulses + pushes, pushes, goal);
        }
    }

    /// How many pulses more than `pulses` the motor may begin on its way down.
    #[inline(never)]
    fn room(&mut self, motor: usize, pulses: u16) -> u16 {
        let back = self.back(motor);
        let room = self.on_time.room(motor, back, &self.layout).saturating_sub(pulses.into());
        u16::try_from(room).unwrap_or(u16::MAX)
    }

    /// Begins the burst up that shifts where the pin rests, or returns when to look again.
    #[inline(never)]
    fn begin_shift(&mut self, motor: usize) -> Option<u32> {
        let later = self.waits_until(motor);
        if later.is_some() {
            return later;
        }
        let now = self.rendered;
        let shifting = self.shifting.as_mut()?;
        let pulses = shifting.pulses;
        shifting.end = Some(now + u64::from(pulses));
        self.on_time.pulses.count(motor, pulses.into());
        self.motors[motor].begin(now, Direction::Up, pulses, 0, 0);
        None
    }

    /// When the first burst of another motor of the group ends.
    fn next_end(&self, motor: usize, ring: &Ring) -> u32 {
        let now = self.rendered.0 as u32;
        let (mut first, mut other) = (u32::MAX, usize::from(ring[motor]));
        while other != motor {
            if let Some(running) = self.motors[other].running {
                first = first.min(running.end().wrapping_sub(now));
            }
            other = ring[other].into();
        }
        now.wrapping_add(first.max(1))
    }
}
