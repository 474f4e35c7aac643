//! Prints the comparisons of this package, as tables or, with `--json`, as the documents that the tables are made of.

mod table;

use anyhow::Result;
use clap::{Parser, Subcommand};
use meissner::cli::give;
use meissner_array::spec::Array;
use meissner_research::{motion_figures, rendering_figures, texture_figures};
use serde::Serialize;
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
    /// Compare motions with what the motors reach: errors, moves and bytes per second
    Motions,
    /// Compare the work of rendering an object with the error of what fingers feel (a minute)
    Rendering,
    /// Compare textures with what the motors can carry of them (a minute)
    Textures,
}

/// Fingers that feel what is rendered.
const FINGERS: u64 = 5;

fn main() -> Result<ExitCode> {
    let Arguments { what, json } = Arguments::parse();
    match what {
        What::Motions => print(json, &motion_figures(Array::paper())?, table::motions::table),
        What::Rendering => print(json, &rendering_figures(FINGERS)?, table::rendering::table),
        What::Textures => print(json, &texture_figures(FINGERS)?, table::rendering::textures),
    }
}

fn print<T: Serialize>(json: bool, found: &T, table: fn(&T) -> Vec<String>) -> Result<ExitCode> {
    give(json, found, || table(found).join("\n"))
}
