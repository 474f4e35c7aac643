//! Judges, queues, withdraws and amends moves of plays.
//!
//! Invariant: what is rendered stays. A move is queued behind all others of its motor, withdrawn only as long as it has not begun, and
//! amended only ahead of the rendered end.

use crate::batch::Amendment;
use crate::controller::FARTHEST;
use crate::controller::newer;
use crate::controller::player::Player;
use crate::controller::player::queue::{Waiting, follow};
use crate::controller::reporting::Reporting;
use crate::limits::{self, Refusal};
use crate::moves::Move;
use crate::tick::Tick;
use core::task::{Poll, ready};

impl Player {
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
        if self.queues.first(motor).is_none()
            && self.motors[motor].is_still()
            && is_low
            && !self.is_to_shift(motor)
        {
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
