//! `displacement`: samples how far a pattern moves each pin, by the motor model. It needs no daemon.
//!
//! Rows are printed as they are computed, so the memory does not grow with the play.

use super::arguments::{ArrayOption, FITS, Output, choice, positive};
use super::output::Stream;
use super::pattern_file;
use crate::receipts::fit;
use anyhow::{Result, bail};
use clap::Args;
use meissner_api::Fit;
use meissner_array::displacement::Displacement as Samples;
use meissner_array::strokes::{StrokeOptions, Strokes};
use std::io::{BufWriter, Write};
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct Displacement {
    /// Sample this pattern: a name of the library, a file (TOML), or - for stdin
    pattern: String,
    /// Play for S seconds: truncate or loop the pattern
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = positive)]
    seconds: Option<f64>,
    /// Choose which strokes are played at the end
    #[arg(long, default_value = "whole", value_parser = choice::<Fit>(FITS))]
    fit: Fit,
    /// Multiply the amplitude of every drive and motion by X, 0 to 1
    #[arg(long, value_name = "X", default_value_t = 1.0, allow_negative_numbers = true, value_parser = positive)]
    scale: f64,
    /// Take F samples a second, 1 to the array's tick rate
    #[arg(long, value_name = "F", default_value_t = 1000.0, allow_negative_numbers = true, value_parser = positive)]
    rate_hz: f64,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    output: Output,
}

pub(super) fn run(asked: &Displacement) -> Result<ExitCode> {
    asked.array.find()?;
    let pattern = pattern_file::of_argument(&asked.pattern)?.pattern;
    asked.array.check(&asked.pattern, pattern.array())?;
    let options = StrokeOptions {
        seconds: asked.seconds,
        scale: asked.scale,
        fit: fit(asked.fit),
        ..StrokeOptions::default()
    };
    let most_hz = pattern.array().rate().hz();
    if !(1.0..=f64::from(most_hz)).contains(&asked.rate_hz) {
        bail!("--rate-hz {}: must be a number, 1 to {most_hz}", asked.rate_hz);
    }
    let strokes = Strokes::new(&pattern, &options)?;
    if strokes.end().is_none() {
        bail!("`{}` has no end: say for how long with --seconds", pattern.name());
    }
    let samples = Samples::new(strokes, asked.rate_hz, 0.0);
    let mut out = BufWriter::new(Stream::Stdout);
    if asked.output.json {
        document(samples, asked, &mut out)?;
    } else {
        table(samples, asked, &mut out)?;
    }
    out.flush()?;
    Ok(ExitCode::SUCCESS)
}

/// A row per sample, a column per pin that moves.
fn table(samples: Samples, asked: &Displacement, out: &mut impl Write) -> Result<()> {
    write!(out, "time_s")?;
    for motor in samples.motors() {
        write!(out, ",motor_{motor}_um")?;
    }
    writeln!(out)?;
    for (number, row) in samples.enumerate() {
        write!(out, "{:.9}", number as f64 / asked.rate_hz)?;
        for um in row? {
            write!(out, ",{}", rounded(um))?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn document(samples: Samples, asked: &Displacement, out: &mut impl Write) -> Result<()> {
    let motors = serde_json::to_string(samples.motors())?;
    let rate_hz = asked.rate_hz;
    write!(out, r#"{{"rate_hz":{rate_hz},"motors":{motors},"displacement_um":["#)?;
    for (number, row) in samples.enumerate() {
        let row: Vec<_> = row?.into_iter().map(rounded).collect();
        write!(out, "{}{}", if number == 0 { "" } else { "," }, serde_json::to_string(&row)?)?;
    }
    writeln!(out, "]}}")?;
    Ok(())
}

/// Rounds to a nanometre, and avoids a negative zero.
fn rounded(um: f64) -> f64 {
    (um * 1000.0).round() / 1000.0 + 0.0
}
