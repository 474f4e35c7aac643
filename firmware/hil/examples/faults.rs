//! `faults [OPTION...] [CASE...]`: plays the cases of `tests/faults`, all of them or those named.
//!
//! `tests/faults/run chip` runs it. It prints what each play has shown, then the kinds that failed. Options:
//!
//! - `--patterns 1` plays the first pattern alone;
//! - `--renew DATE COMMIT` writes the chip's column of the book's page; kinds that were not played
//!   keep what they had.

use meissner_fault_cases::page::{Account, Cell, Target, path, renew, row_of};
use meissner_fault_cases::{Kind, PATTERNS, cases, jobs, kinds_of, report, run};
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::faults::{not_possible, play};
use std::process::ExitCode;
use std::time::Instant;

const USAGE: &str = "faults [--patterns N] [--renew DATE COMMIT] [CASE...]";

struct Arguments {
    patterns: usize,
    renew: Option<(String, String)>,
    cases: Vec<String>,
}

fn arguments(mut given: impl Iterator<Item = String>) -> Option<Arguments> {
    let mut all = Arguments { patterns: PATTERNS.len(), renew: None, cases: Vec::new() };
    while let Some(argument) = given.next() {
        match argument.as_str() {
            "--patterns" => {
                let patterns = given.next()?.parse().ok();
                all.patterns = patterns.filter(|patterns| (1..=PATTERNS.len()).contains(patterns))?;
            }
            "--renew" => all.renew = Some((given.next()?, given.next()?)),
            option if option.starts_with('-') => return None,
            _ => all.cases.push(argument),
        }
    }
    Some(all)
}

fn main() -> ExitCode {
    let Some(Arguments { patterns, renew: account, cases: names }) = arguments(std::env::args().skip(1))
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
    let on_the_chip = |kind: &Kind<'_>, pattern: &str, seed| {
        play(&Which::Chip(ChipOptions::new(seed)), kind, pattern, seed)
    };
    let shown = run(&kinds, patterns, jobs(), on_the_chip, |line| println!("{line}"));
    let (possible, plays) = (kinds.len(), kinds.len() * patterns.len());
    let seconds = begun.elapsed().as_secs_f64();
    println!("{possible} kinds, {plays} plays in {seconds:.0} s; {} kinds are not possible", others.len());
    let is_good = report(&shown);
    if let Some((date, commit)) = account {
        let remark = format!(
            "{possible} of {possible} kinds that are possible, with {}; nothing is added to the bounds",
            patterns.join(", ")
        );
        let command = "tests/faults/run chip --renew";
        let account = Account { date: &date, commit: &commit, command, remark: &remark };
        let played = kinds.iter().zip(&shown).map(|(kind, shown)| (row_of(kind), Cell::from(shown)));
        let others =
            others.iter().filter_map(|kind| Some((row_of(kind), Cell::NotPossible(not_possible(kind)?))));
        if let Err(error) = renew(Target::Chip, &account, &played.chain(others).collect(), &cases) {
            eprintln!("{}: {error}", path().display());
            return ExitCode::FAILURE;
        }
    }
    if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
