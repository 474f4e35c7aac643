//! An update of a live play, on its way to the streamer and back.
//!
//! Invariant: each update taken comes back in one [`super::StreamEvent::LiveUpdated`], to be dropped outside the thread, unless
//! the event queue is full. The sender of updates bounds how many are under way.

use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::tick::Tick;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::strokes::LiveMotion;

/// New motions for a live play.
#[derive(Debug)]
pub struct LiveUpdate {
    /// The play.
    pub id: u64,
    /// The client's number of the update.
    pub number: u64,
    /// When the client's message had come.
    pub received_at: HostInstant,
    /// The new motion of each motor; `None`: as before. Without any the update only shows that the client is there.
    pub motions: PerMotor<Option<LiveMotion>>,
    /// What became of it.
    pub result: LiveResult,
}

/// What became of an update.
#[expect(clippy::large_enum_variant, reason = "an update is boxed with it")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LiveResult {
    /// It is not decided.
    Waiting,
    /// It is on the device.
    Applied(Applied),
    /// A newer update took its place before it was sent.
    Merged {
        /// The newer one's number.
        into: u64,
    },
    /// The play is over, or no play has this id, or the update is for another array.
    Over,
}

/// When an update is on the pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Applied {
    /// The device's tick when the client's message had come.
    pub received: Tick,
    /// The tick from which strokes were replaced, each motor's from its next period on. If the update was sent again, this is the
    /// tick of the last frame; earlier frames replaced strokes from earlier ticks on.
    pub replaced: Tick,
    /// The tick from which each motor has its new drive; `None`: it had it before, or gets it with a newer update.
    pub motors: PerMotor<Option<Tick>>,
    /// How often a frame came too late for some motor, and was sent again.
    pub repeats: u32,
    /// Moves of the play that the device has refused since the last update that was applied: they are not on the pins.
    pub refused: u64,
}

impl Applied {
    /// The same for all motors but these, which get their drives later.
    pub(crate) fn without(mut self, motors: MotorSet) -> Self {
        for (from, motor) in self.motors.iter_mut().zip(0..) {
            *from = from.filter(|_| !motors.contains(motor));
        }
        self
    }
}

impl LiveUpdate {
    /// An update for a play on this array that changes nothing.
    pub fn new(array: Array, id: u64, number: u64, received_at: HostInstant) -> Self {
        Self { id, number, received_at, motions: PerMotor::all(array, None), result: LiveResult::Waiting }
    }
}
