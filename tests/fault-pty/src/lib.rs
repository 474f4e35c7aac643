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

#![expect(missing_docs, missing_debug_implementations, reason = "only tests use it")]
#![expect(clippy::unwrap_used, clippy::missing_panics_doc, reason = "a test that panics has failed")]

mod board;
mod daemon;
mod player;
mod watch;

use meissner_fault_cases::{Kind, Seen, Worst};
use meissner_stream::device::priority::{BELOW_STREAMER, fifo};
use meissner_stream::time::HostInstant;
use player::play;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;
use watch::Watch;

/// Added to each bound on time. The machine stands still for up to 25 ms now and then (`docs/measurements.md`): once for the
/// daemon and once for the board; and an order comes through a socket.
pub const ALLOWANCE_MS: f64 = 60.0;
/// A thread that did not run for so long has shown that the machine stood still, or had too much to do.
const STOOD_STILL: Duration = Duration::from_millis(10);
/// A play that failed while the machine stood still says nothing about the daemon, and is played again, so many times in all.
const TRIES: u32 = 5;

/// How to run.
#[derive(Clone, Copy)]
pub struct Plan<'a> {
    /// The program `meissner`.
    pub program: &'a Path,
    pub patterns: &'a [&'a str],
    /// Plays at once.
    pub jobs: usize,
}

/// What a kind has shown.
#[derive(Clone, Debug, Default)]
pub struct Shown {
    pub worst: Worst,
    pub problems: Vec<String>,
    /// Plays that failed while the machine stood still, and were played again.
    pub repeated: u32,
}

/// Plays each kind with each pattern; `tell` hears of each that is over.
pub fn run(plan: &Plan<'_>, kinds: &[Kind<'_>], tell: impl Fn(&str) + Sync) -> Vec<Shown> {
    let shown: Vec<_> = kinds.iter().map(|_| Mutex::new(Shown::default())).collect();
    let plays: Vec<_> = (0..kinds.len())
        .flat_map(|kind| plan.patterns.iter().zip(1..).map(move |(pattern, seed)| (kind, *pattern, seed)))
        .collect();
    let next = AtomicUsize::new(0);
    let watch = Watch::start();
    thread::scope(|scope| {
        for _ in 0..plan.jobs.min(plays.len()) {
            scope.spawn(|| {
                // A fault has to come when its case says. Without real-time priority it comes when it can.
                let _ = fifo(BELOW_STREAMER - 1);
                while let Some(&(at, pattern, seed)) = plays.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let kind = &kinds[at];
                    let (seen, repeated) = try_to_play(plan.program, &watch, kind, pattern, seed);
                    let name = format!("{} {}, {pattern}", kind.case.name, kind.label());
                    let mut shown = shown[at].lock().unwrap();
                    shown.repeated += repeated;
                    match seen {
                        Ok(seen) => {
                            tell(&format!("{name}: {seen:?}"));
                            shown.worst.add(&seen);
                        }
                        Err(problem) => {
                            tell(&format!("{name}: FAILED: {problem}"));
                            shown.problems.push(format!("{name}: {problem}"));
                        }
                    }
                }
            });
        }
    });
    shown.into_iter().map(|shown| shown.into_inner().unwrap()).collect()
}

/// Returns also how often it was played again.
fn try_to_play(
    program: &Path,
    watch: &Watch,
    kind: &Kind<'_>,
    pattern: &str,
    seed: u64,
) -> (Result<Seen, String>, u32) {
    let mut repeated = 0;
    loop {
        let begun = HostInstant::now();
        let (seen, late) = play(program, kind, pattern, seed);
        let stood_still = late.max(watch.worst_since(begun));
        let is_last = repeated + 1 == TRIES;
        match seen {
            Err(_) if stood_still > STOOD_STILL && !is_last => repeated += 1,
            seen => {
                let remark = |problem| format!("{problem} (the machine stood still for {stood_still:?})");
                return (seen.map_err(remark), repeated);
            }
        }
    }
}
