//! The strokes that the device has been asked to withdraw, until it tells of which motors it has withdrawn them.
//!
//! A frame that comes too late withdraws nothing: then the old strokes are played, and position control must know them again. At most
//! one replacement per motor is under way.
//!
//! Invariant: frames are judged in order. So until the answer, verdicts of frames on strokes of such a motor concern old strokes.

use super::queued::Queued;
use firmware_protocol::array::MotorSet;
use firmware_protocol::controller::POOL;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;

/// The replacement under way.
#[derive(Debug)]
pub(super) struct Replacement {
    from: Tick,
    /// The motors without an answer.
    motors: MotorSet,
    /// Their strokes, each motor's from the last to the first. The device's pool bounds them.
    strokes: Vec<Queued>,
}

impl Replacement {
    pub(super) fn new(array: Array) -> Self {
        // Touch every page now, as the queues do.
        let mut strokes = vec![Queued::NOTHING; POOL + array.motors()];
        strokes.clear();
        Self { from: Tick(0), motors: MotorSet::EMPTY, strokes }
    }

    /// Begins a replacement of these motors' strokes.
    pub(super) fn begin(&mut self, motors: MotorSet, from: Tick) {
        (self.motors, self.from) = (motors, from);
        self.strokes.clear();
    }

    pub(super) const fn from(&self) -> Tick {
        self.from
    }

    /// Holds a stroke. Beyond the bound, which no device reaches, it is forgotten, as if the device had withdrawn it.
    pub(super) fn hold(&mut self, queued: Queued) {
        if self.strokes.len() < self.strokes.capacity() {
            self.strokes.push(queued);
        }
    }

    /// The strokes of a motor in order of time.
    pub(super) fn of(&self, motor: u8) -> impl Iterator<Item = Queued> {
        self.strokes.iter().rev().filter(move |queued| queued.stroke.motor == motor).copied()
    }

    fn find(&self, motor: u8, up: Tick) -> Option<usize> {
        let is_it = |queued: &Queued| queued.stroke.motor == motor && queued.stroke.up == up;
        if self.motors.contains(motor) { self.strokes.iter().position(is_it) } else { None }
    }

    /// The device has accepted a stroke, before it was asked to withdraw it. `false`: the stroke is not among these.
    pub(super) fn accepted(&mut self, motor: u8, up: Tick) -> bool {
        let found = self.find(motor, up);
        if let Some(at) = found {
            self.strokes[at].accepted = true;
        }
        found.is_some()
    }

    /// The device will not play a stroke. `false`: the stroke is not among these.
    pub(super) fn withdrawn(&mut self, motor: u8, up: Tick) -> bool {
        let found = self.find(motor, up);
        if let Some(at) = found {
            self.strokes.remove(at);
        }
        found.is_some()
    }

    /// The device has answered for these motors.
    pub(super) fn end(&mut self, motors: MotorSet) {
        self.motors = self.motors.without(motors);
        self.strokes.retain(|queued| !motors.contains(queued.stroke.motor));
    }

    /// The device has flushed its queue.
    pub(super) fn clear(&mut self) {
        self.motors = MotorSet::EMPTY;
        self.strokes.clear();
    }
}
