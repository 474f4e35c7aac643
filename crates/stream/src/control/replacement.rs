//! The strokes that the device has been asked to withdraw, until it tells of which motors it has withdrawn them.
//!
//! A frame that comes too late withdraws nothing: then the old strokes are played, and position control must know them again. At most
//! one replacement per motor is under way.
//!
//! Invariant: frames are judged in order. So until the answer, verdicts of frames on strokes of such a motor concern old strokes.

use super::queued::Queued;
use firmware_protocol::controller::POOL;
use firmware_protocol::stroke::MOTORS;
use firmware_protocol::tick::Tick;

/// The replacement under way.
#[derive(Debug)]
pub(super) struct Replacement {
    from: Tick,
    /// The motors without an answer.
    motors: u64,
    /// Their strokes, each motor's from the last to the first. The device's pool bounds them.
    strokes: Vec<Queued>,
}

impl Replacement {
    pub(super) fn new() -> Self {
        // Touch every page now, as the queues do.
        let mut strokes = vec![Queued::NOTHING; POOL + MOTORS];
        strokes.clear();
        Self { from: Tick(0), motors: 0, strokes }
    }

    /// Begins a replacement of these motors' strokes.
    pub(super) fn begin(&mut self, motors: u64, from: Tick) {
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
        let waits = self.motors >> motor & 1 == 1;
        let is_it = |queued: &Queued| queued.stroke.motor == motor && queued.stroke.up == up;
        if waits { self.strokes.iter().position(is_it) } else { None }
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
    pub(super) fn end(&mut self, motors: u64) {
        self.motors &= !motors;
        self.strokes.retain(|queued| motors >> queued.stroke.motor & 1 == 0);
    }

    /// The device has flushed its queue.
    pub(super) fn clear(&mut self) {
        self.motors = 0;
        self.strokes.clear();
    }
}
