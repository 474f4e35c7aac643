//! Plays kinds with patterns, many at once, and keeps what they have shown.
//!
//! Invariant: what is shown does not depend on which play ends first.

use crate::case::Kind;
use crate::judge::Seen;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// What a kind has shown.
#[derive(Clone, Debug, Default)]
pub struct Shown {
    /// What was not as expected.
    pub problems: Vec<String>,
    /// The same of plays that say nothing about the program.
    pub unjudged: Vec<String>,
}

/// What was not as expected of a play.
#[derive(Debug)]
pub struct Failure {
    /// In words.
    pub problem: String,
    /// Whether it says something about the program: the machine did not stand still meanwhile.
    pub judged: bool,
}

impl From<String> for Failure {
    fn from(problem: String) -> Self {
        Self { problem, judged: true }
    }
}

/// As many plays at once as there are processors.
pub fn jobs() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Plays each kind with each pattern, whose number is the seed, `jobs` at once; `tell` hears of each play that is over.
pub fn run<E: Into<Failure>>(
    kinds: &[Kind<'_>],
    patterns: &[&str],
    jobs: usize,
    play: impl Fn(&Kind<'_>, &str, u64) -> Result<Seen, E> + Sync,
    tell: impl Fn(&str) + Sync,
) -> Vec<Shown> {
    let plays: Vec<_> = kinds
        .iter()
        .flat_map(|kind| patterns.iter().zip(1..).map(move |(pattern, seed)| (kind, *pattern, seed)))
        .map(|play| (play, OnceLock::new()))
        .collect();
    let next = AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..jobs.min(plays.len()) {
            scope.spawn(|| {
                while let Some(((kind, pattern, seed), seen)) =
                    plays.get(next.fetch_add(1, Ordering::Relaxed))
                {
                    let name = format!("{}, {}, {pattern}", kind.case.name, kind.label());
                    let result = play(kind, pattern, *seed).map_err(|failure| {
                        let Failure { problem, judged } = failure.into();
                        Failure { problem: format!("{name}: {problem}"), judged }
                    });
                    tell(&match &result {
                        Ok(seen) => format!("{name}: {seen:?}"),
                        Err(Failure { problem, judged: true }) => format!("FAILED: {problem}"),
                        Err(Failure { problem, judged: false }) => format!("not judged: {problem}"),
                    });
                    seen.set(result).unwrap();
                }
            });
        }
    });
    let mut seen = plays.into_iter().map(|(_, seen)| seen.into_inner().unwrap());
    let of_kind = |_| {
        let mut shown = Shown::default();
        for seen in seen.by_ref().take(patterns.len()) {
            match seen {
                Ok(_) => {}
                Err(Failure { problem, judged: true }) => shown.problems.push(problem),
                Err(Failure { problem, judged: false }) => shown.unjudged.push(problem),
            }
        }
        shown
    };
    kinds.iter().map(of_kind).collect()
}

/// Prints what was not as expected; returns whether all was, in plays that were all judged.
pub fn report(shown: &[Shown]) -> bool {
    for Shown { problems, unjudged, .. } in shown {
        problems.iter().for_each(|problem| println!("failed: {problem}"));
        unjudged.iter().for_each(|problem| println!("not judged: {problem}"));
    }
    shown.iter().all(|shown| shown.problems.is_empty() && shown.unjudged.is_empty())
}
