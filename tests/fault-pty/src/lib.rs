//! Faults by script in real time: a real daemon on a serial port, whose board is the recorded mock behind a pseudo-terminal.
//!
//! [`run`] plays kinds of faults with patterns, many at once: each waits most of the time. In the order of a play:
//!
//! - `board`: the mock at the far end of the terminal, behind a line that may be bad, with a clock that may run wrong.
//! - `daemon`: the process under test, stopped and killed as the case says.
//! - `watch`: when the machine stood still: a play that failed meanwhile is played again.
//! - `player`: one play that meets the faults of one case, and its judgement.
//!
//! Invariant: no daemon outlives the run, whether it is stopped or not.

#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

mod board;
mod daemon;
mod player;
mod watch;

use meissner_fault_cases::{Failure, Kind, Seen, Shown};
use meissner_stream::device::priority::{BELOW_STREAMER, fifo};
use meissner_stream::time::HostInstant;
use player::play;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use watch::Watch;

/// Added to each bound on time. The machine stands still for up to 25 ms now and then (`docs/dev/measurements.md`): once for the
/// daemon and once for the board; and an order comes through a socket.
pub const ALLOWANCE_MS: f64 = 60.0;
/// A thread that did not run for so long has shown that the machine stood still, or had too much to do.
const STOOD_STILL: Duration = Duration::from_millis(10);
/// A play that failed while the machine stood still says nothing about the daemon, and is played again, so many times in all.
const TRIES: u32 = 10;
/// First the machine has to run without a pause for [`CALM`]. This is the longest wait for that.
const LONGEST_WAIT: Duration = Duration::from_secs(20);
const CALM: Duration = Duration::from_millis(500);

/// Plays each kind with each pattern, `jobs` at once; `tell` hears of each that is over. Returns also how many plays failed while
/// the machine stood still, and were played again. One whose every try did is not judged.
pub fn run(
    program: &Path,
    patterns: &[&str],
    jobs: usize,
    kinds: &[Kind<'_>],
    tell: impl Fn(&str) + Sync,
) -> (Vec<Shown>, u32) {
    let (watch, all_repeated) = (Watch::start(), AtomicU32::new(0));
    let play = |kind: &Kind<'_>, pattern: &str, seed| {
        // A fault has to come when its case says. Without real-time priority it comes when it can.
        let _ = fifo(BELOW_STREAMER - 1);
        let (seen, repeated) = try_to_play(program, &watch, kind, pattern, seed);
        all_repeated.fetch_add(repeated, Ordering::Relaxed);
        seen
    };
    (meissner_fault_cases::run(kinds, patterns, jobs, play, tell), all_repeated.into_inner())
}

/// Returns also how often it was played again.
fn try_to_play(
    program: &Path,
    watch: &Watch,
    kind: &Kind<'_>,
    pattern: &str,
    seed: u64,
) -> (Result<Seen, Failure>, u32) {
    let mut repeated = 0;
    loop {
        let begun = HostInstant::now();
        let (seen, late) = play(program, kind, pattern, seed);
        let stood_still = late.max(watch.worst_since(begun));
        let is_last = repeated + 1 == TRIES;
        match seen {
            Err(_) if stood_still > STOOD_STILL && !is_last => {
                repeated += 1;
                watch.wait_until_calm(CALM, STOOD_STILL, LONGEST_WAIT);
            }
            seen => {
                let failure = |problem| Failure {
                    problem: format!("{problem} (the machine stood still for {stood_still:?})"),
                    judged: stood_still <= STOOD_STILL,
                };
                return (seen.map_err(failure), repeated);
            }
        }
    }
}
