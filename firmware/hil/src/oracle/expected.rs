//! What is expected of the lines.

use crate::log::Log;
use firmware_protocol::message::{Cause, Trigger};
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;

/// An interval in which any part of the plan may have been played.
#[derive(Clone, Debug)]
pub struct Soft {
    /// The first tick.
    pub from: Tick,
    /// The first tick after it.
    pub to: Tick,
    /// The plan within it.
    pub planned: Log,
}

/// A cut as the device reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CutAt {
    /// The reason.
    pub cause: Cause,
    /// The first tick in which nothing of the queue was played.
    pub at: Tick,
    /// How many ticks after `at` the pins are down at the latest; `None` if they stayed.
    pub return_ticks: Option<u32>,
    /// Outstanding return pulses.
    pub outstanding: u32,
}

/// What is expected of the lines in one boot.
#[derive(Clone, Debug, Default)]
pub struct Expected {
    /// The pulses, exact outside of the soft intervals.
    pub log: Log,
    /// Intervals in which pulses may be missing.
    pub soft: Vec<Soft>,
    /// Onsets of the plays that have begun.
    pub onsets: Vec<Tick>,
    /// What the trigger output gives, by the tick at which it begins.
    pub triggers: Vec<(Tick, Trigger)>,
    /// The cuts, in order.
    pub cuts: Vec<CutAt>,
    /// Contradictions between the device's reports, or to the specification.
    pub contradictions: Vec<String>,
    /// The moves that begin, in the order in which they were sent.
    pub moves: Vec<Move>,
    /// The accepted moves that were replaced: when each was to begin, and the cycle at which its replacement was sent.
    pub replaced: Vec<(Tick, u64)>,
    /// When the drivers may be on without a pulse: before moves that were refused or flushed, or for which the pin was there already.
    pub silent: Vec<(Tick, Tick)>,
}
