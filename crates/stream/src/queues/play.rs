//! A play as the daemon hands it to the streamer.

use crate::bandwidth::Bandwidth;
use crate::time::HostInstant;
use firmware_protocol::tick::Tick;
use meissner_api::LatePolicy;
use meissner_array::strokes::Strokes;

/// When a play begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum At {
    /// As soon as possible, or without a gap after the play before it.
    Next,
    /// At this tick of the device's present boot.
    Tick(Tick),
    /// At the tick nearest to this instant of the host's clock, by the estimate when the streamer takes the command.
    Monotonic(HostInstant),
    /// So many nanoseconds after the streamer takes the command.
    After(u64),
}

/// A compiled pattern, ready to be played.
#[derive(Debug)]
pub struct Play {
    /// Identifies the play in events.
    pub id: u64,
    /// Its strokes.
    pub strokes: Strokes,
    /// When it begins.
    pub at: At,
    /// What to do when strokes are late.
    pub late: LatePolicy,
    /// Stop the running play and clear the queue first.
    pub replace: bool,
    /// Do not correct from telemetry.
    pub open_loop: bool,
    /// The bandwidth it requires; [`Bandwidth::default`] requires none.
    pub bandwidth: Bandwidth,
}
