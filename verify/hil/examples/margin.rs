//! `margin [PATTERNS]`: the time that rendering has left over so many random patterns (200), in each condition; for starts of all motors after
//! rests and holds; then while strokes are replaced at full load, and while all motors follow rows. `margin 0` does the last two alone.
//!
//! Exit 0 if at least half of the time is left in all of them, but for plays that a daemon refuses. Takes minutes.

#![expect(clippy::unwrap_used, reason = "what cannot go on has failed")]

#[path = "../tests/hand.rs"]
mod hand;
#[path = "../tests/margin.rs"]
mod margin;
#[path = "../tests/play.rs"]
#[expect(dead_code, reason = "it is the tests', which use the rest of it")]
mod play;
#[path = "../tests/random.rs"]
mod random;
#[path = "../tests/replace_load.rs"]
mod replace_load;

use margin::{Beside, after_rests, sweep};
use replace_load::{CONDITIONS, ROWS, load, rows};
use std::process::ExitCode;
use std::thread;

/// Returns whether half of the time is left.
type Run = Box<dyn FnOnce() -> bool + Send>;

fn main() -> ExitCode {
    let patterns = std::env::args().nth(1).map_or(200, |number| number.parse().unwrap());
    let conditions = [
        (1.0, Beside::Nothing),
        (1.1, Beside::Nothing),
        (1.0, Beside::Noise),
        (1.1, Beside::Noise),
        (1.1, Beside::Pings),
        (1.1, Beside::EStops),
        (1.1, Beside::KeptLimit),
        (1.1, Beside::BrokenLimit),
    ];
    let conditions = conditions.iter().filter(|_| patterns > 0);
    let plays = conditions.map(|&(slow, beside)| -> Run {
        Box::new(move || sweep(slow, beside, 0..patterns) || beside == Beside::BrokenLimit)
    });
    let starts = [(1.0, false), (1.0, true), (1.1, false), (1.1, true)].into_iter().filter(|_| patterns > 0);
    let starts = starts.map(|(slow, has_stop)| -> Run { Box::new(move || after_rests(slow, has_stop)) });
    let replaced = CONDITIONS.iter().map(|&condition| -> Run { Box::new(move || load(condition)) });
    let follow = ROWS.iter().map(|&(slow, most)| -> Run { Box::new(move || rows(slow, most)) });
    let mut runs: Vec<_> = plays.chain(starts).chain(replaced).chain(follow).collect();
    // Two at a time.
    let mut whole = true;
    while !runs.is_empty() {
        let pair: Vec<_> = runs.drain(..runs.len().min(2)).map(thread::spawn).collect();
        for run in pair {
            whole &= run.join().is_ok_and(|half| half);
        }
    }
    if whole { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
