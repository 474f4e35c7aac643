//! `faults [OPTION...] [CASE...]`: plays the cases of `tests/faults`, all of them or those named.
//!
//! `tests/faults/run chip` runs it. It prints what each play has shown, then the kinds that failed. Options:
//!
//! - `--mock` plays on the mock instead of the chip;
//! - `--patterns 1` plays the first pattern alone;
//! - `--jobs 8` plays so many at once, instead of one for each processor;
//! - `--minutes 20` begins no play later than that;
//! - `--renew DATE COMMIT` writes the chip's column of the book's page; kinds that were not played
//!   keep what they had.

use meissner_fault_cases::page::{Account, Cell, Target, path, renew, row_of};
use meissner_fault_cases::{Case, Kind, PATTERNS, cases, kinds_of};
use meissner_hil::faults::{On, Plan, Shown, jobs, not_possible, run};
use std::collections::BTreeMap;
use std::io;
use std::process::ExitCode;
use std::time::{Duration, Instant};

const USAGE: &str = "faults [--mock] [--patterns N] [--jobs N] [--minutes N] [--renew DATE COMMIT] [CASE...]";

struct Arguments {
    on: On,
    patterns: usize,
    jobs: usize,
    minutes: Option<u64>,
    renew: Option<(String, String)>,
    cases: Vec<String>,
}

fn arguments(mut given: impl Iterator<Item = String>) -> Option<Arguments> {
    let mut all = Arguments {
        on: On::Chip,
        patterns: PATTERNS.len(),
        jobs: jobs(),
        minutes: None,
        renew: None,
        cases: Vec::new(),
    };
    while let Some(argument) = given.next() {
        match argument.as_str() {
            "--mock" => all.on = On::Mock,
            "--patterns" => {
                let patterns = given.next()?.parse().ok();
                all.patterns = patterns.filter(|patterns| (1..=PATTERNS.len()).contains(patterns))?;
            }
            "--jobs" => all.jobs = given.next()?.parse().ok()?,
            "--minutes" => all.minutes = Some(given.next()?.parse().ok()?),
            "--renew" => all.renew = Some((given.next()?, given.next()?)),
            option if option.starts_with('-') => return None,
            _ => all.cases.push(argument),
        }
    }
    Some(all)
}

fn main() -> ExitCode {
    let Some(Arguments { on, patterns, jobs, minutes, renew: account, cases: names }) =
        arguments(std::env::args().skip(1))
    else {
        eprintln!("{USAGE}");
        return ExitCode::from(2);
    };
    let cases = cases();
    let all = match kinds_of(&cases, &names) {
        Ok(all) => all,
        Err(problem) => {
            eprintln!("{problem}");
            return ExitCode::from(2);
        }
    };
    let (kinds, others): (Vec<Kind<'_>>, Vec<_>) =
        all.into_iter().partition(|kind| not_possible(kind).is_none());
    let patterns = &PATTERNS[..patterns];
    let begun = Instant::now();
    let until = minutes.map(|minutes| begun + Duration::from_secs(60 * minutes));
    let plan = Plan { on, patterns, jobs, until };
    let shown = run(&plan, &kinds, |line| println!("{line}"));
    let seconds = begun.elapsed().as_secs_f64();
    let plays: usize = shown.iter().map(|shown| shown.plays).sum();
    println!(
        "{} kinds, {plays} plays in {seconds:.0} s; {} kinds are not possible",
        kinds.len(),
        others.len()
    );
    let problems: Vec<&String> = shown.iter().flat_map(|shown| &shown.problems).collect();
    for problem in &problems {
        println!("failed: {problem}");
    }
    if let Some((date, commit)) = account
        && on == On::Chip
    {
        let played: Vec<_> =
            kinds.iter().zip(&shown).filter(|(_, shown)| shown.plays == patterns.len()).collect();
        let remark = format!(
            "{} of {} kinds that are possible, with {}; nothing is added to the bounds",
            played.len(),
            kinds.len(),
            patterns.join(", ")
        );
        let account = Account {
            date: &date,
            commit: &commit,
            command: "tests/faults/run chip --renew",
            remark: &remark,
        };
        if let Err(error) = write(&account, &played, &others, &cases) {
            eprintln!("{}: {error}", path().display());
            return ExitCode::FAILURE;
        }
    }
    if problems.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Writes the column of the book.
fn write(
    account: &Account<'_>,
    played: &[(&Kind<'_>, &Shown)],
    others: &[Kind<'_>],
    cases: &[Case],
) -> io::Result<()> {
    let played = played.iter().map(|(kind, shown)| {
        let cell = if shown.problems.is_empty() { Cell::Worst(shown.worst.clone()) } else { Cell::Failed };
        (row_of(kind), cell)
    });
    let others =
        others.iter().filter_map(|kind| Some((row_of(kind), Cell::NotPossible(not_possible(kind)?))));
    let cells: BTreeMap<_, _> = played.chain(others).collect();
    renew(Target::Chip, account, &cells, cases)
}
