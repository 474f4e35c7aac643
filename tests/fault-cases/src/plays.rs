//! Plays kinds with patterns, many at once, and keeps what they have shown.
//!
//! Invariant: what is shown does not depend on which play ends first.

use crate::case::Kind;
use crate::judge::Seen;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// As many plays at once as there are processors.
pub fn jobs() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Plays each kind with each pattern, whose number is the seed, `jobs` at once; `tell` hears of each play that is over. Returns what
/// was not as expected.
pub fn run(
    kinds: &[Kind<'_>],
    patterns: &[&str],
    jobs: usize,
    play: impl Fn(&Kind<'_>, &str, u64) -> Result<Seen, String> + Sync,
    tell: impl Fn(&str) + Sync,
) -> Vec<String> {
    let plays: Vec<_> = kinds
        .iter()
        .flat_map(|kind| patterns.iter().zip(1..).map(move |(pattern, seed)| (kind, *pattern, seed)))
        .map(|play| (play, OnceLock::new()))
        .collect();
    let next = AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..jobs.min(plays.len()) {
            scope.spawn(|| {
                while let Some(((kind, pattern, seed), problem)) =
                    plays.get(next.fetch_add(1, Ordering::Relaxed))
                {
                    let name = format!("{}, {}, {pattern}", kind.case.name, kind.label());
                    let found = match play(kind, pattern, *seed) {
                        Ok(seen) => {
                            tell(&format!("{name}: {seen:?}"));
                            None
                        }
                        Err(found) => {
                            tell(&format!("FAILED: {name}: {found}"));
                            Some(format!("{name}: {found}"))
                        }
                    };
                    problem.set(found).unwrap();
                }
            });
        }
    });
    plays.into_iter().filter_map(|(_, problem)| problem.into_inner().unwrap()).collect()
}
