//! Computes what the lines have to do from what went over the link.
//!
//! It implements the specification a second time. The `plan` has the moves that the device has accepted, as far as its reports say, and
//! what interrupted them. `pins` follows the one rule tick by tick: a pin goes up only by a move in time, and comes down whenever it is
//! above its goal. At the edge of an e-stop or a failure a pulse cannot be predicted: there a [`Soft`] interval allows it to be missing.

mod expected;
mod pins;
mod plan;
#[cfg(test)]
mod tests;

use crate::tap::Tap;
pub use expected::{CutAt, Expected, Soft};
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;
use plan::Plan;

/// Ticks after a failure of the core in which rendered pulses may still be played.
pub const HORIZON: u64 = 64;

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
