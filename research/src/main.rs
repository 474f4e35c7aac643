//! Prints the comparisons of this package, as tables or, with `--json`, as the documents that the tables are made of.

mod table;

use anyhow::Result;
use clap::{Parser, Subcommand};
use meissner::cli::{give, text_of_file};
use meissner_array::spec::Array;
use meissner_research::{
    ControlGrid, LEADS_MS, MAX_TRACE_BYTES, STALLS, StopGrid, Trace, control_tradeoff, drift_figures,
    lead_tradeoff, motion_figures, rendering_figures, stop_tradeoff, texture_figures,
};
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;

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
    /// Compare motions with what the motors reach: errors, moves and bytes per second
    Motions,
    /// Compare the drift of noise without telemetry with its theory, with and without a lower stop
    Drift,
    /// Compare the work of rendering an object with the error of what fingers feel (a minute)
    Rendering,
    /// Compare textures with what the motors can carry of them (a minute)
    Textures,
}

/// Fingers that feel what is rendered.
const FINGERS: u64 = 5;
/// Seconds of noise.
const DRIFT_S: u32 = 60;

fn main() -> Result<ExitCode> {
    let Arguments { what, json } = Arguments::parse();
    match what {
        What::Lead { trace: None } => {
            let trace = Trace::read(STALLS, "stalls.txt")?;
            print(json, &lead_tradeoff(&trace, &LEADS_MS), table::lead::table)
        }
        What::Lead { trace: Some(file) } => {
            let text = text_of_file(&file, MAX_TRACE_BYTES, "trace")?;
            let trace = Trace::read(&text, &file.to_string_lossy())?;
            print(json, &lead_tradeoff(&trace, &LEADS_MS), table::lead::table)
        }
        What::Loop => print(json, &control_tradeoff(&ControlGrid::default())?, table::control::table),
        What::Stop => print(json, &stop_tradeoff(&StopGrid::default())?, table::stop::table),
        What::Motions => print(json, &motion_figures(Array::paper())?, table::motions::table),
        What::Drift => print(json, &drift_figures(Array::paper(), DRIFT_S)?, table::motions::drift),
        What::Rendering => print(json, &rendering_figures(FINGERS)?, table::rendering::table),
        What::Textures => print(json, &texture_figures(FINGERS)?, table::rendering::textures),
    }
}

fn print<T: Serialize>(json: bool, found: &T, table: fn(&T) -> Vec<String>) -> Result<ExitCode> {
    give(json, found, || table(found).join("\n"))
}
