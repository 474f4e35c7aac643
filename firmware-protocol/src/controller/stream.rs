//! Accepts the ordered stream of strokes, withdraws queued ones that it replaces, and amends queued strokes.
//!
//! [`Controller::unpack`] prepares frames in order and buffers the others; [`Controller::take`] takes them.

use crate::batch::Malformed;
use crate::controller::player::NEVER;
use crate::controller::reporting::RESERVE;
use crate::controller::taking::{Next, Packed};
use crate::controller::{Controller, newer};
use crate::limits::Refusal;
use crate::stroke::Stroke;
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
        self.reporting.reports().free() > reports && (head.mark.is_none() || self.player.takes_mark())
    }

    /// Judges a stroke by itself. `Ok(false)` if it is late.
    fn judge(&self, stroke: &Stroke) -> Result<bool, Refusal> {
        if !self.motion.is_armed() {
            return Err(Refusal::NotArmed);
        }
        self.player.judge(stroke, self.now)
    }

    /// Queues a stroke. `Ok(false)` if it is late.
    pub(super) fn accept(&mut self, stroke: &Stroke) -> Result<bool, Refusal> {
        if !self.judge(stroke)? || self.kept >> stroke.motor & 1 == 1 {
            return Ok(false);
        }
        self.player.append(stroke, self.generation, &self.reporting)?;
        Ok(true)
    }

    /// Withdraws the strokes of `motor` from `from` on, if none of them has begun and `first`, the stroke that takes their place,
    /// can be queued. Otherwise all of them stay, and the motor's new strokes are late until the next withdrawal. Returns whether
    /// it has withdrawn them.
    pub(super) fn withdraw(&mut self, motor: u8, from: Tick, first: Option<&Stroke>) -> bool {
        let bit = 1 << motor;
        let usable = first.map_or(self.motion.is_armed(), |first| self.judge(first) == Ok(true));
        let next = first.map_or(NEVER, |first| first.up);
        let withdrawn = if usable { self.player.withdraw(motor, from, next) } else { None };
        let Some(strokes) = withdrawn else {
            self.kept |= bit;
            return false;
        };
        self.kept &= !bit;
        self.reporting.count().replaced += 2 * u64::from(strokes);
        true
    }

    /// The host has made an amendment of this generation.
    pub(super) fn note_generation(&mut self, generation: u16) {
        if self.generation.is_none_or(|old| newer(generation, old)) {
            self.generation = Some(generation);
        }
    }
}
