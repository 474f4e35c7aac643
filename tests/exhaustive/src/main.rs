//! Explores, and prints how many states there are and what is broken.

use clap::{Parser, Subcommand};
use meissner_exhaustive::{device, link};
use stateright::{Checker, HasDiscoveries, Model};
use std::fmt::Debug;
use std::hash::Hash;
use std::process::ExitCode;
use std::time::Instant;

/// Explores all orders of events within bounds.
#[derive(Debug, Parser)]
struct Args {
    #[command(subcommand)]
    model: Explore,
    /// Threads.
    #[arg(long, global = true, default_value_t = 2)]
    threads: usize,
    /// Print the counts as the rest of a table's row.
    #[arg(long, global = true)]
    row: bool,
}

#[derive(Debug, Subcommand)]
enum Explore {
    /// The controller alone.
    Device {
        /// Messages and events at most.
        #[arg(long, default_value_t = 2)]
        events: u8,
        /// How many of them may be faults.
        #[arg(long, default_value_t = 1)]
        faults: u8,
        /// Ticks in which they happen.
        #[arg(long, default_value_t = 150)]
        ticks: u64,
        /// Let them happen in every tick, not only around changes.
        #[arg(long)]
        every_tick: bool,
        /// Allow only one motor of the rail to have pulses at once.
        #[arg(long)]
        one_at_once: bool,
    },
    /// The host's link session and the controller.
    Link {
        /// Calls of the session at most.
        #[arg(long, default_value_t = 2)]
        calls: u8,
        /// Faults of the line and the device at most.
        #[arg(long, default_value_t = 1)]
        faults: u8,
        /// Waits at most.
        #[arg(long, default_value_t = 2)]
        waits: u8,
    },
}

fn main() -> ExitCode {
    let Args { model, threads, row } = Args::parse();
    match model {
        Explore::Device { events, faults, ticks, every_tick, one_at_once } => {
            let bounds = device::Bounds { events, faults, ticks, every_tick, one_at_once };
            explore(device::Device(bounds), threads, row)
        }
        Explore::Link { calls, faults, waits } => {
            explore(link::Link(link::Bounds { calls, faults, waits }), threads, row)
        }
    }
}

fn explore<M>(model: M, threads: usize, row: bool) -> ExitCode
where
    M: Model + Send + Sync + 'static,
    M::State: Clone + Debug + Hash + PartialEq + Send + Sync,
    M::Action: Clone + Debug + PartialEq,
{
    let begun = Instant::now();
    let checker =
        model.checker().threads(threads).finish_when(HasDiscoveries::AnyFailures).spawn_dfs().join();
    let (states, distinct) = (checker.state_count(), checker.unique_state_count());
    let (depth, s) = (checker.max_depth(), begun.elapsed().as_secs_f64());
    if row {
        println!("{states} | {distinct} | {depth} | {s:.0} s |");
    } else {
        println!("{states} states, {distinct} of them distinct, depth {depth}, {s:.1} s");
    }
    let (mut broken, found) = (false, checker.discoveries());
    for property in checker.model().properties() {
        let path = found.get(property.name);
        if path.is_some() != property.expectation.discovery_is_failure() {
            continue;
        }
        broken = true;
        println!("{}: {}", if path.is_some() { "broken" } else { "never met" }, property.name);
        for step in path.into_iter().flat_map(|path| path.clone().into_actions()) {
            println!("    {step:?}");
        }
    }
    if broken { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
