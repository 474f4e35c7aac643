//! Plays the cases of `tests/faults` on a bench: many at once, each on a device of its own.
//!
//! [`run`] is used by the example `faults` (`tests/faults/run chip`), and by the tests for some of them. A play, and how it is
//! judged, is in `player` and `verdict`; what cannot be played on a board is named by [`not_possible`]. The bounds on time are those of
//! virtual time: nothing is added for the chip.

mod player;
mod verdict;

use crate::bench::Which;
use crate::bench::chip::ChipOptions;
use meissner_fault_cases::{Kind, Seen, What, Worst};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

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

/// What to play on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum On {
    /// The mock, as a check of the runner.
    Mock,
    /// The firmware in the emulated chip.
    Chip,
}

impl On {
    fn which(self, seed: u64) -> Which {
        match self {
            Self::Mock => Which::Mock(seed),
            Self::Chip => Which::Chip(ChipOptions::new(seed)),
        }
    }
}

/// What a kind has shown.
#[derive(Clone, Debug, Default)]
pub struct Shown {
    /// Over the patterns.
    pub worst: Worst,
    /// Plays so far.
    pub plays: usize,
    /// What was not as expected.
    pub problems: Vec<String>,
}

/// How to run.
#[derive(Clone, Copy, Debug)]
pub struct Plan<'a> {
    /// What to play on.
    pub on: On,
    /// The patterns of the library.
    pub patterns: &'a [&'a str],
    /// Plays at once.
    pub jobs: usize,
    /// No play begins later.
    pub until: Option<Instant>,
}

/// As many plays at once as there are processors.
#[must_use]
pub fn jobs() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Plays each kind with each pattern; `tell` hears of each play that is over.
pub fn run(plan: &Plan<'_>, kinds: &[Kind<'_>], tell: impl Fn(&str) + Sync) -> Vec<Shown> {
    let Plan { on, patterns, jobs, until } = *plan;
    let shown: Vec<_> = kinds.iter().map(|_| Mutex::new(Shown::default())).collect();
    let plays: Vec<_> = (0..kinds.len())
        .flat_map(|kind| patterns.iter().zip(1..).map(move |(pattern, seed)| (kind, *pattern, seed)))
        .collect();
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..jobs.min(plays.len()) {
            scope.spawn(|| {
                while let Some(&(at, pattern, seed)) = plays.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if until.is_some_and(|until| Instant::now() >= until) {
                        break;
                    }
                    let seen = play(&on.which(seed), &kinds[at], pattern, seed);
                    tell(&add(&shown[at], &kinds[at], pattern, seen));
                }
            });
        }
    });
    shown.into_iter().map(|shown| shown.into_inner().unwrap_or_else(PoisonError::into_inner)).collect()
}

fn add(shown: &Mutex<Shown>, kind: &Kind<'_>, pattern: &str, seen: Result<Seen, String>) -> String {
    let mut shown = shown.lock().unwrap_or_else(PoisonError::into_inner);
    shown.plays += 1;
    let name = format!("{} {}, {pattern}", kind.case.name, kind.label());
    match seen {
        Ok(seen) => {
            shown.worst.add(&seen);
            format!("{name}: {seen:?}")
        }
        Err(problem) => {
            shown.problems.push(format!("{name}: {problem}"));
            format!("{name}: FAILED: {problem}")
        }
    }
}
