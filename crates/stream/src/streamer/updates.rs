//! The state of a live play's updates: which is under way, and which motors have it.

use crate::queues::{Applied, LiveResult, LiveUpdate};
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::tick::Tick;

/// The updates of the live play that is playing.
#[derive(Debug, Default)]
pub(super) struct Live {
    /// The play that the rest is about.
    pub(super) of: Option<u64>,
    /// The update that waits, and the one under way.
    pub(super) waiting: Option<Box<LiveUpdate>>,
    pub(super) sent: Option<Box<LiveUpdate>>,
    /// The motors for which the device has not answered, and those whose old strokes it kept.
    pub(super) unanswered: MotorSet,
    pub(super) kept: MotorSet,
    /// From which tick on the last update replaced strokes.
    pub(super) replaced: Tick,
    /// Room for delays, ticks: grows when a frame came too late.
    pub(super) spare: u64,
    /// The refused moves that answers have told.
    pub(super) refused: u64,
    /// The play ends if its client is silent until then.
    pub(super) deadline: HostInstant,
}

impl Live {
    /// Whether the device has not said yet if it has replaced the strokes of `motor`, or keeps the old ones.
    pub(super) const fn is_undecided(&self, motor: u8) -> bool {
        self.unanswered.contains(motor)
    }

    /// The same with the moves that were refused since the last answer, of so many in all.
    pub(super) const fn with_refused(&mut self, applied: Applied, refused: u64) -> LiveResult {
        let new = refused.saturating_sub(self.refused);
        self.refused = refused;
        LiveResult::Applied(Applied { refused: new, ..applied })
    }
}
