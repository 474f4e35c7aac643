//! Accepts the ordered stream of strokes, withdraws queued ones that it replaces, and amends queued strokes.
//!
//! [`Controller::unpack`] prepares frames in order and buffers the others; [`Controller::take`] takes them.

use crate::batch::{Amendment, Malformed};
use crate::controller::pool::{Kind, Slot, charge};
use crate::controller::reporting::RESERVE;
use crate::controller::taking::{Next, Packed};
use crate::controller::{Controller, FARTHEST, NEVER, newer};
use crate::limits::{self, Refusal};
use crate::message::State;
use crate::stroke::{Direction, Stroke};
use crate::tick::Tick;

impl Controller {
    /// Unpacks the first piece of a frame of the ordered stream.
    pub(super) fn unpack_first(&mut self, head: Next, received: Option<(u16, u16)>, batch: &[u8]) {
        let packed = self.taking.begin(head, received, batch);
        self.unpack(packed);
    }

    /// Unpacks a piece of a frame of the ordered stream. One that cannot be read to its end changes nothing.
    pub(super) fn unpack(&mut self, packed: Packed) {
        match self.taking.unpack_piece(packed) {
            Ok(None) => {}
            Ok(Some(Packed { head, received: None, .. })) => self.taking.next = Some(head),
            Ok(Some(Packed { head, received: Some((epoch, seen)), .. })) => {
                self.session.heard(self.now);
                self.reporting.send_status();
                self.reporting.seen(seen, self.now);
                if epoch == self.session.epoch() {
                    self.stream(head);
                }
            }
            Err(Malformed) => self.reporting.count().bad_frames += 1,
        }
    }

    /// Prepares the frame that was unpacked if it is next in order. Else buffers it for [`Self::follow`].
    fn stream(&mut self, head: Next) {
        if head.seq != self.next_seq {
            self.reorder.insert(self.next_seq, head, self.taking.items());
        } else if self.has_room(&head) {
            self.taking.next = Some(head);
        }
    }

    /// Prepares one buffered frame if it is next in order.
    pub(super) fn follow(&mut self) -> bool {
        let Some(frame) = self.reorder.take(self.next_seq) else { return false };
        // Without room the frame is forgotten; the host sends it again.
        if self.has_room(&frame.head) {
            self.taking.epoch = self.session.epoch();
            self.reporting.send_status();
            self.unpack_first(frame.head, None, &frame.batch);
        }
        true
    }

    /// Whether there is room for a frame's reports and its mark.
    fn has_room(&self, head: &Next) -> bool {
        let reports = RESERVE + usize::from(head.mark.is_some());
        self.reporting.reports().free() > reports && (head.mark.is_none() || !self.marks.is_full())
    }

    /// Judges a stroke by itself. `Ok(false)` if it is late.
    fn judge(&self, stroke: &Stroke) -> Result<bool, Refusal> {
        if self.state != State::Armed {
            return Err(Refusal::NotArmed);
        }
        limits::check(stroke)?;
        if stroke.down_pulses > stroke.up_pulses && !self.allowance.has_stop() {
            return Err(Refusal::Pushing);
        }
        if stroke.up >= self.ready() && stroke.down.since(self.now) > FARTHEST {
            return Err(Refusal::TooFar);
        }
        Ok(stroke.up >= self.ready())
    }

    /// Queues a stroke. `Ok(false)` if it is late.
    pub(super) fn accept(&mut self, stroke: &Stroke) -> Result<bool, Refusal> {
        if !self.judge(stroke)? || self.kept >> stroke.motor & 1 == 1 {
            return Ok(false);
        }
        if self.pool.end(stroke.motor.into()).is_some_and(|end| stroke.up < end) {
            return Err(Refusal::Overlap);
        }
        if stroke.up < self.pool.last_up(stroke.motor.into()) + limits::LEAST_APART {
            return Err(Refusal::Dense);
        }
        let room = self.credits() > 0;
        let slot = Slot { generation: [self.generation; 2], ..Slot::new(*stroke, Kind::Play) };
        if room && self.queue(slot) { Ok(true) } else { Err(Refusal::PoolFull) }
    }

    /// Withdraws the strokes of `motor` from `from` on, if none of them has begun and `first`, the stroke that takes their place,
    /// can be queued. Otherwise all of them stay, and the motor's new strokes are late until the next withdrawal. Returns whether
    /// it has withdrawn them.
    pub(super) fn withdraw(&mut self, motor: u8, from: Tick, first: Option<&Stroke>) -> bool {
        let bit = 1 << motor;
        let usable = first.map_or(self.state == State::Armed, |first| self.judge(first) == Ok(true));
        let next = first.map_or(NEVER, |first| first.up);
        let withdrawn =
            if usable { self.pool.withdraw(motor.into(), from, next, self.rendered) } else { None };
        let Some(strokes) = withdrawn else {
            self.kept |= bit;
            return false;
        };
        self.kept &= !bit;
        self.reporting.count().replaced += 2 * u64::from(strokes);
        let is_high = (self.lines.up | self.lines.down) & bit != 0;
        if self.pool.current(motor.into()).is_none() && !is_high {
            // The line waits for the withdrawn stroke no longer, nor do the drivers.
            self.changes.forget(motor.into());
        }
        true
    }

    /// The host has made an amendment of this generation.
    pub(super) fn note_generation(&mut self, generation: u16) {
        if self.generation.is_none_or(|old| newer(generation, old)) {
            self.generation = Some(generation);
        }
    }

    /// Changes the pulse count of a burst that is not rendered yet. `None` if the amendment is ignored.
    pub(super) fn amend(&mut self, generation: u16, item: &Amendment) -> Option<()> {
        let index = self.pool.find(item.motor.into(), item.up)?;
        let slot = self.pool.get(index)?;
        let room_after = self.pool.get(slot.next).map_or(NEVER, |next| next.stroke.up);
        let rendered = self.rendered;
        let has_stop = self.allowance.has_stop();
        let slot = self.pool.get_mut(index)?;
        let half = usize::from(item.direction == Direction::Down);
        let burst = slot.stroke.bursts()[half];
        let room = if half == 0 { slot.stroke.down } else { room_after };
        let newest = slot.generation[half].is_none_or(|old| newer(generation, old));
        let fits = limits::within_correction(slot.planned[half], item.pulses)
            && burst.start + u64::from(item.pulses) <= room
            && (1..=[limits::MAX_UP_PULSES, limits::MAX_DOWN_PULSES][half]).contains(&item.pulses)
            && (half == 0 || !has_stop || item.pulses <= slot.planned[1]);
        if self.state != State::Armed || slot.kind != Kind::Play || burst.start < rendered || !newest || !fits
        {
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
                .lengthen(rendered, item.motor.into(), stroke.pulses() - u32::from(*charged))
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
