//! `faults [OPTION...] [CASE...]`: plays the cases of `tests/faults`, all of them or those named.
//!
//! It prints what each play has shown, then the kinds that failed. `--patterns 1` plays the first
//! pattern alone.

use meissner_fault_cases::{Kind, PATTERNS, cases, jobs, kinds_of, run};
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::faults::{not_possible, play};
use std::process::ExitCode;
use std::time::Instant;

const USAGE: &str = "faults [--patterns N] [CASE...]";

struct Arguments {
    patterns: usize,
    cases: Vec<String>,
}

fn arguments(mut given: impl Iterator<Item = String>) -> Option<Arguments> {
    let mut all = Arguments { patterns: PATTERNS.len(), cases: Vec::new() };
    while let Some(argument) = given.next() {
        match argument.as_str() {
            "--patterns" => {
                let patterns = given.next()?.parse().ok();
                all.patterns = patterns.filter(|patterns| (1..=PATTERNS.len()).contains(patterns))?;
            }
            option if option.starts_with('-') => return None,
            _ => all.cases.push(argument),
        }
    }
    Some(all)
}

fn main() -> ExitCode {
    let Some(Arguments { patterns, cases: names }) = arguments(std::env::args().skip(1)) else {
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
    let problems = run(&kinds, patterns, jobs(), on_the_chip, |line| println!("{line}"));
    let (possible, plays) = (kinds.len(), kinds.len() * patterns.len());
    let seconds = begun.elapsed().as_secs_f64();
    println!("{possible} kinds, {plays} plays in {seconds:.0} s; {} kinds are not possible", others.len());
    problems.iter().for_each(|problem| println!("failed: {problem}"));
    if problems.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
