//! Plays the cases of `tests/faults` against a real daemon in real time: `tests/faults/run pty`.
//!
//! It prints what each play has shown, then the kinds that failed.

use clap::Parser;
use meissner_fault_cases::{PATTERNS, cases, kinds_of, report};
use meissner_fault_pty::run;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Play faults against a real daemon behind a pseudo-terminal.
#[derive(Parser)]
struct Arguments {
    /// The program `meissner`.
    program: PathBuf,
    /// Play only the cases with these names.
    cases: Vec<String>,
    /// Play N at once.
    #[arg(long, value_name = "N", default_value = "12")]
    jobs: NonZeroUsize,
}

fn main() -> ExitCode {
    let Arguments { program, cases: names, jobs } = Arguments::parse();
    let cases = cases();
    let kinds = match kinds_of(&cases, &names) {
        Ok(kinds) => kinds,
        Err(problem) => {
            eprintln!("{problem}");
            return ExitCode::from(2);
        }
    };
    let begun = Instant::now();
    let (shown, repeated) = run(&program, &PATTERNS, jobs.get(), &kinds, |line| println!("{line}"));
    let plays = kinds.len() * PATTERNS.len();
    println!(
        "{} kinds, {plays} plays in {:.0} s, {repeated} played again because the machine stood still",
        kinds.len(),
        begun.elapsed().as_secs_f64()
    );
    if report(&shown) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
