//! Plays the cases of `tests/faults` against a real daemon in real time: `tests/faults/run pty`.
//!
//! It prints what each play has shown, then the kinds that failed; with `--renew` it writes its column of the book's page.

use clap::Parser;
use meissner_fault_cases::page::{Account, Cell, Target, path, renew, row_of};
use meissner_fault_cases::{PATTERNS, cases, kinds_of, report};
use meissner_fault_pty::{ALLOWANCE_MS, run};
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
    /// Write the cells of the book of the kinds that were played, as of this date and commit.
    #[arg(long, num_args = 2, value_names = ["DATE", "COMMIT"])]
    renew: Option<Vec<String>>,
}

fn main() -> ExitCode {
    let Arguments { program, cases: names, jobs, renew: account } = Arguments::parse();
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
    let is_good = report(&shown);
    if let Some([date, commit]) = account.as_deref() {
        let cells = kinds.iter().zip(&shown).map(|(kind, shown)| (row_of(kind), Cell::from(shown)));
        let remark = format!(
            "{} kinds, {plays} plays; bounds on time and {ALLOWANCE_MS} ms; {repeated} plays were repeated because the machine \
             stood still",
            kinds.len()
        );
        let account = Account { date, commit, command: "tests/faults/run pty --renew", remark: &remark };
        if let Err(error) = renew(Target::Pty, &account, &cells.collect(), &cases) {
            eprintln!("{}: {error}", path().display());
            return ExitCode::FAILURE;
        }
    }
    if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
