//! `margin [PATTERNS]`: the time that rendering has left over so many random patterns (200), in each condition.
//!
//! Exit 0 if at least half of the time is left in all of them. Takes minutes.

#![expect(clippy::unwrap_used, reason = "what cannot go on has failed")]

#[path = "../tests/margin.rs"]
mod margin;
#[path = "../tests/play.rs"]
#[expect(dead_code, reason = "it is the tests', which use the rest of it")]
mod play;
#[path = "../tests/random.rs"]
mod random;

use margin::{Beside, sweep};
use std::process::ExitCode;
use std::thread;

fn main() -> ExitCode {
    let patterns = std::env::args().nth(1).map_or(200, |number| number.parse().unwrap());
    let conditions = [
        (1.0, Beside::Nothing),
        (1.1, Beside::Nothing),
        (1.0, Beside::Noise),
        (1.1, Beside::Noise),
        (1.1, Beside::Pings),
        (1.1, Beside::EStops),
    ];
    // Two at a time.
    let mut whole = true;
    for pair in conditions.chunks(2) {
        let runs = pair.iter().map(|&(slow, beside)| thread::spawn(move || sweep(slow, beside, 0..patterns)));
        let runs: Vec<_> = runs.collect();
        for run in runs {
            whole &= run.join().is_ok_and(|half| half);
        }
    }
    if whole { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
