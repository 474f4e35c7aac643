//! Judges, queues, withdraws and amends strokes of plays.
//!
//! Invariant: what is rendered stays. A stroke is queued behind all others of its motor, withdrawn only as long as it has not begun,
//! and amended only where its burst lies ahead of the rendered end.

use crate::batch::Amendment;
use crate::controller::FARTHEST;
use crate::controller::newer;
use crate::controller::player::pool::{Kind, Slot, charge};
use crate::controller::player::{NEVER, Player};
use crate::controller::reporting::Reporting;
use crate::limits::{self, Refusal};
use crate::stroke::{Direction, Stroke};
use crate::tick::Tick;

impl Player {
    /// Judges a stroke by itself. `Ok(false)` if it is late.
    pub(in crate::controller) fn judge(&self, stroke: &Stroke, now: Tick) -> Result<bool, Refusal> {
        self.layout.check(stroke)?;
        if stroke.down_pulses > stroke.up_pulses && !self.has_stop() {
            return Err(Refusal::Pushing);
        }
        if stroke.up >= self.ready() && stroke.down.since(now) > FARTHEST {
            return Err(Refusal::TooFar);
        }
        Ok(stroke.up >= self.ready())
    }

    /// Queues a stroke that is not late. Takes only amendments newer than `generation`.
    pub(in crate::controller) fn append(
        &mut self,
        stroke: &Stroke,
        generation: Option<u16>,
        reporting: &Reporting,
    ) -> Result<(), Refusal> {
        if self.pool.end(stroke.motor.into()).is_some_and(|end| stroke.up < end) {
            return Err(Refusal::Overlap);
        }
        if stroke.up < self.pool.earliest_up(stroke.motor.into()) {
            return Err(Refusal::Dense);
        }
        let room = self.credits(reporting) > 0;
        let slot = Slot { generation: [generation; 2], ..Slot::new(*stroke, Kind::Play) };
        if room && self.queue(slot) { Ok(()) } else { Err(Refusal::PoolFull) }
    }

    /// Withdraws the strokes of `motor` from `from` on, and returns their number. `None`, and all of them stay, if one of them has
    /// begun or one before them does not end by `next`.
    pub(in crate::controller) fn withdraw(&mut self, motor: u8, from: Tick, next: Tick) -> Option<u16> {
        let strokes = self.pool.withdraw(motor.into(), from, next, self.rendered)?;
        let is_high = self.lines.pulsing().contains(motor);
        if self.pool.current(motor.into()).is_none() && !is_high {
            // The line waits for the withdrawn stroke no longer, nor do the drivers.
            self.changes.forget(motor.into());
        }
        Some(strokes)
    }

    /// Changes the pulse count of a burst that is not rendered yet. `None` if the amendment is ignored.
    pub(in crate::controller) fn amend(&mut self, generation: u16, item: &Amendment) -> Option<()> {
        let index = self.pool.find(item.motor.into(), item.up)?;
        let slot = self.pool.get(index)?;
        let room_after = self.pool.get(slot.next).map_or(NEVER, |next| next.stroke.up);
        let rendered = self.rendered;
        let has_stop = self.allowance.has_stop();
        let slot = self.pool.get_mut(index)?;
        let half = usize::from(item.direction == Direction::Down);
        let most = [self.layout.max_up_pulses(), self.layout.max_down_pulses()];
        let burst = slot.stroke.bursts()[half];
        let room = if half == 0 { slot.stroke.down } else { room_after };
        let newest = slot.generation[half].is_none_or(|old| newer(generation, old));
        let fits = limits::within_correction(slot.planned[half], item.pulses)
            && burst.start + u64::from(item.pulses) <= room
            && (1..=most[half]).contains(&item.pulses)
            && (half == 0 || !has_stop || item.pulses <= slot.planned[1]);
        if slot.kind != Kind::Play || burst.start < rendered || !newest || !fits {
            return None;
        }
        let mut stroke = slot.stroke;
        match item.direction {
            Direction::Up => stroke.up_pulses = item.pulses,
            Direction::Down => stroke.down_pulses = item.pulses,
        }
        // Even a length that the stroke had before may break a limit on motors at once: another stroke may have begun since.
        if slot.charged.is_some() && item.pulses > burst.pulses {
            self.check_at_once(&stroke).ok()?;
        }
        let slot = self.pool.get_mut(index)?;
        if let Some(charged) = &mut slot.charged
            && stroke.pulses() > u32::from(*charged)
        {
            self.allowance
                .lengthen(rendered, item.motor.into(), stroke.pulses() - u32::from(*charged), &self.layout)
                .ok()?;
            *charged = charge(&stroke);
        }
        slot.generation[half] = Some(generation);
        slot.stroke = stroke;
        if has_stop && half == 0 {
            // The up burst is not rendered, so the stroke is not counted yet.
            slot.raise_pushes(item.pulses);
        }
        self.next_end = self.next_end.min(stroke.end());
        Some(())
    }
}
