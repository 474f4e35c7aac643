//! The steps that the device has been asked to withdraw, until it tells of which motors it has withdrawn them.
//!
//! A frame that comes too late withdraws nothing: then the old steps are played, and position control must know them again. At most
//! one replacement per motor is under way.
//!
//! Invariant: frames are judged in order. So until the answer, verdicts of frames on steps of such a motor concern old ones.

use super::queued::Queued;
use firmware_protocol::array::MotorSet;
use firmware_protocol::controller::POOL;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use std::ops::Range;

/// The replacement under way.
#[derive(Debug)]
pub(super) struct Replacement {
    from: Tick,
    /// The motors without an answer.
    motors: MotorSet,
    /// Their bursts, each motor's from the last to the first. The device's pool bounds them.
    bursts: Vec<Queued>,
}

impl Replacement {
    pub(super) fn new(array: Array) -> Self {
        // Touch every page now, as the queues do.
        let mut bursts = vec![Queued::NOTHING; POOL + array.motors()];
        bursts.clear();
        Self { from: Tick(0), motors: MotorSet::EMPTY, bursts }
    }

    /// Begins a replacement of these motors' steps.
    pub(super) fn begin(&mut self, motors: MotorSet, from: Tick) {
        (self.motors, self.from) = (motors, from);
        self.bursts.clear();
    }

    pub(super) const fn from(&self) -> Tick {
        self.from
    }

    /// Holds a burst. Beyond the bound, which no device reaches, it is forgotten, as if the device had withdrawn it.
    pub(super) fn hold(&mut self, queued: Queued) {
        if self.bursts.len() < self.bursts.capacity() {
            self.bursts.push(queued);
        }
    }

    /// The bursts of a motor in order of time.
    pub(super) fn of(&self, motor: u8) -> impl Iterator<Item = Queued> {
        self.bursts.iter().rev().filter(move |queued| queued.motor == motor).copied()
    }

    /// The bursts of the step of this motor that begins at this tick: the second one of a stroke is held before the first.
    fn find(&self, motor: u8, begin: Tick) -> Option<Range<usize>> {
        let is_it = |queued: &Queued| queued.motor == motor && queued.burst.start == begin;
        let first = self.bursts.iter().position(is_it).filter(|_| self.motors.contains(motor))?;
        let second = first.checked_sub(1).filter(|&second| self.bursts[second].joined);
        Some(second.unwrap_or(first)..first + 1)
    }

    /// The device has accepted a step, before it was asked to withdraw it. `false`: it is not among these.
    pub(super) fn accepted(&mut self, motor: u8, begin: Tick) -> bool {
        let Some(step) = self.find(motor, begin) else { return false };
        self.bursts[step].iter_mut().for_each(|queued| queued.accepted = true);
        true
    }

    /// The device will not play a step. `false`: it is not among these.
    pub(super) fn withdrawn(&mut self, motor: u8, begin: Tick) -> bool {
        let Some(step) = self.find(motor, begin) else { return false };
        self.bursts.drain(step);
        true
    }

    /// The device has answered for these motors.
    pub(super) fn end(&mut self, motors: MotorSet) {
        self.motors = self.motors.without(motors);
        self.bursts.retain(|queued| !motors.contains(queued.motor));
    }

    /// The device has flushed its queue.
    pub(super) fn clear(&mut self) {
        self.motors = MotorSet::EMPTY;
        self.bursts.clear();
    }
}
