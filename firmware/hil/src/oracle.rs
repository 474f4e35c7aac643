//! Computes what the lines have to do from what went over the link.
//!
//! It implements the specification a second time. The `plan` has the moves that the device has accepted, as far as its reports say, and
//! what interrupted them. `pins` follows the one rule tick by tick: a pin goes up only by a move in time, and comes down whenever it is
//! above its goal. At the edge of an e-stop or a failure a pulse cannot be predicted: there a [`Soft`] interval allows it to be missing.

mod pins;
mod plan;
#[cfg(test)]
mod tests;

use crate::log::Log;
use crate::tap::Tap;
use firmware_protocol::message::{Cause, Trigger};
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;
use plan::Plan;

/// Ticks after a failure of the core in which rendered pulses may still be played.
pub const HORIZON: u64 = 64;

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

/// What the lines had to do, if the core failed at tick `death` or not at all.
#[must_use]
pub fn expect(tap: &Tap, death: Option<Tick>) -> Expected {
    let mut expected = pins::play(Plan::of(tap));
    if let Some(death) = death {
        // The tick of the failure may be cut short.
        let (from, to) = (Tick(death.0 - 1), death + HORIZON);
        let planned = expected.log.within(from, to);
        expected.log = expected.log.within(Tick(0), to);
        expected.soft.push(Soft { from, to, planned });
    }
    expected
}

/// The moves that the device has begun or will begin, as far as it has reported, and whether each is the second of a stroke.
#[must_use]
pub fn accepted(tap: &Tap) -> Vec<(Move, bool)> {
    let plan = Plan::of(tap);
    plan.moves.iter().filter(|live| live.begins()).map(|live| (live.to, live.joined)).collect()
}
