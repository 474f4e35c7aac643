//! Prints the comparisons of this package, as tables or, with `--json`, as the documents that the tables are made of.

mod table;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use meissner::store::Store;
use meissner_research::{
    ControlGrid, LEADS_MS, STALLS, StopGrid, Trace, control_tradeoff, lead_tradeoff, objective_tradeoff,
    stop_tradeoff,
};
use meissner_skin::ModelName;
use serde::Serialize;
use std::path::PathBuf;

/// Comparisons behind the figures of the book. `meissner tradeoff` compares simulation methods.
#[derive(Debug, Parser)]
struct Arguments {
    #[command(subcommand)]
    what: What,
    /// Print one JSON document
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Compare leads of the streamer: late bursts, onsets and bytes, in virtual time under recorded stalls
    Lead {
        /// Use the stalls in FILE, recorded with the example `record_stalls`
        #[arg(long, value_name = "FILE")]
        trace: Option<PathBuf>,
    },
    /// Compare position control: rest errors and amplitudes with their bounds, at all settings (minutes)
    Loop,
    /// Compare surpluses of down bursts above a lower stop: rest errors with their theory (half a minute)
    Stop,
    /// Compare what a search maximises: patterns by each objective and by naive rules (minutes)
    Objectives {
        /// Search under the second model, not the first
        #[arg(long)]
        afferents: bool,
    },
}

/// Evaluations of each search; more would hardly improve the result.
const EVALUATIONS: u64 = 1000;

fn main() -> Result<()> {
    let Arguments { what, json } = Arguments::parse();
    match what {
        What::Lead { trace: None } => {
            give(json, &lead_tradeoff(&Trace::read(STALLS, "stalls.txt")?, &LEADS_MS), table::lead::table)
        }
        What::Lead { trace: Some(file) } => {
            let name = file.to_string_lossy();
            let text = std::fs::read_to_string(&file).with_context(|| name.to_string())?;
            give(json, &lead_tradeoff(&Trace::read(&text, &name)?, &LEADS_MS), table::lead::table)
        }
        What::Loop => give(json, &control_tradeoff(&ControlGrid::default())?, table::control::table),
        What::Stop => give(json, &stop_tradeoff(&StopGrid::default())?, table::stop::table),
        What::Objectives { afferents } => {
            let store = Store::new(None, false)?;
            let library = |name: &str| store.library(name).map(|stored| stored.pattern.drives().to_vec());
            let model = if afferents { ModelName::Afferents } else { ModelName::Membrane };
            give(json, &objective_tradeoff(EVALUATIONS, model, &library)?, table::objectives::table)
        }
    }
}

fn give<T: Serialize>(json: bool, found: &T, table: impl FnOnce(&T) -> Vec<String>) -> Result<()> {
    println!("{}", if json { serde_json::to_string(found)? } else { table(found).join("\n") });
    Ok(())
}
