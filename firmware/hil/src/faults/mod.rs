//! Plays the cases of `tests/faults` on a bench, each on a device of its own.
//!
//! [`play`] is used by the example `faults` (`cargo run -p meissner-hil --example faults`), and by the tests for some of them. A play, and how it is
//! judged, is in `player` and `verdict`; what cannot be played on a board is named by [`not_possible`]. The bounds on time are those of
//! virtual time: nothing is added for the chip.

mod player;
mod verdict;

use meissner_fault_cases::{Kind, What};

pub use player::play;

/// Why a kind cannot be played on a board.
#[must_use]
pub fn not_possible(kind: &Kind<'_>) -> Option<&'static str> {
    let is_first = kind.case.values.first() == Some(&kind.value);
    kind.case.fault.iter().find_map(|fault| match fault.what {
        What::Telemetry(_) => Some("the board has no sensor"),
        What::Hang(_) if !is_first => Some("the board's watchdog waits 100 ms, whatever hangs"),
        _ => None,
    })
}
