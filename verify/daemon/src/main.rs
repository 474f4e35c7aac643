//! Runs days of the whole daemon under a seed, with faults, in virtual time, and judges them by plain rules.
//!
//! A rule that is broken ends it with 1, and with the seed that repeats the run to the byte.

use clap::Parser;
use meissner::daemon::{Report, run_days};
use std::panic::catch_unwind;
use std::process::ExitCode;

/// Run days of the whole daemon under a seed
#[derive(Parser)]
struct Arguments {
    /// The seed: the same one repeats a run to the byte
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Days of virtual time
    #[arg(long, default_value_t = 1)]
    days: u32,
    /// What clients and the world do on each day
    #[arg(long, default_value_t = 300)]
    steps: u32,
}

fn main() -> ExitCode {
    let Arguments { seed, days, steps } = Arguments::parse();
    let Ok(Report { days: done, steps: all, plays, faults, trace }) =
        catch_unwind(|| run_days(seed, days, steps))
    else {
        println!("broken: --seed {seed} --days {days} --steps {steps}");
        return ExitCode::FAILURE;
    };
    println!("seed {seed}: {done} days, {all} steps, {plays} plays, {faults} faults, trace {trace}");
    ExitCode::SUCCESS
}
