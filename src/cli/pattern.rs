//! `pattern`: packs a pattern with its sample files, and says what motors will do with its motions. It needs no daemon.

use super::arguments::{ArrayOption, Output, positive};
use super::motions::Motions;
use super::output::{give, say_file, tell};
use super::{files, pattern_file, text};
use crate::receipts::Outline;
use crate::store::hash;
use anyhow::{Result, bail};
use clap::{Args, Subcommand};
use meissner_array::pattern::Motion;
use meissner_array::strokes::StrokeOptions;
use serde::Serialize;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, Subcommand)]
pub(super) enum Pattern {
    /// Put the sample files that a pattern's waves name into the pattern
    Pack {
        /// Read the pattern from this file (TOML); its sample files lie in the same directory, or where their names lead
        file: PathBuf,
        /// Write the packed pattern to FILE [default: stdout]
        #[arg(short = 'o', long = "output", value_name = "FILE")]
        to: Option<PathBuf>,
        /// Print one JSON document on stdout and nothing else
        #[arg(long, requires = "to")]
        json: bool,
    },
    /// Compute what the motors will do with a pattern's motions: errors, moves and bytes per second
    Check(Check),
}

#[derive(Debug, Args)]
pub(super) struct Check {
    /// Compute for this pattern: a name of the library, a file (TOML), or - for stdin
    pattern: String,
    /// Multiply all motions by X, 0 to 1
    #[arg(long, value_name = "X", default_value_t = 1.0, allow_negative_numbers = true, value_parser = positive)]
    scale: f64,
    /// Exit with 1 if a motor is too slow for its motion, or saturated
    #[arg(long)]
    strict: bool,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    output: Output,
}

/// The document of `pattern pack --json`.
#[derive(Serialize)]
struct Packed<'a> {
    name: &'a str,
    sha256: String,
    bytes: usize,
    waves: Vec<PackedWave<'a>>,
}

#[derive(Serialize)]
struct PackedWave<'a> {
    motor: u8,
    start_s: f64,
    rate_hz: f64,
    samples: usize,
    /// What the samples were made from.
    source: Option<&'a str>,
}

/// The document of `pattern check --json`.
#[derive(Serialize)]
struct Checked<'a> {
    name: &'a str,
    array: &'a str,
    duration_s: Option<f64>,
    drives: usize,
    motions: usize,
    /// Null without motions.
    followed: Option<Motions>,
    /// Lines for drives and motions that do not do what the pattern says.
    warnings: Vec<String>,
}

pub(super) fn run(asked: &Pattern) -> Result<ExitCode> {
    match asked {
        Pattern::Pack { file, to, json } => pack(file, to.as_deref(), *json),
        Pattern::Check(asked) => check(asked),
    }
}

fn pack(file: &Path, to: Option<&Path>, json: bool) -> Result<ExitCode> {
    let is_itself =
        |to: &Path| fs::canonicalize(to).is_ok_and(|to| fs::canonicalize(file).is_ok_and(|of| of == to));
    if let Some(to) = to.filter(|to| is_itself(to)) {
        bail!("{}: this is the pattern's own file: write to another", files::shown(to));
    }
    let place = to.map(files::beside).transpose()?;
    let found = pattern_file::of_file(file)?;
    let waves: Vec<_> = found.pattern.motions().iter().filter_map(wave).collect();
    let lines = || {
        let line = |of: &PackedWave<'_>| {
            let PackedWave { motor, rate_hz, samples, source, .. } = of;
            let from = source.map_or_else(String::new, |source| format!(": {source}"));
            format!("motor {motor}: {samples} samples at {rate_hz} Hz{from}")
        };
        let mut lines: Vec<_> = waves.iter().map(line).collect();
        if !found.was_packed {
            lines.push("no wave names a file: the pattern is complete as it is".to_owned());
        }
        lines.join("\n")
    };
    let Some(place) = place else {
        tell(&lines());
        say_file(found.text.trim_end())?;
        return Ok(ExitCode::SUCCESS);
    };
    place.write(&found.text)?;
    let text =
        || format!("{}\n{} bytes, {}", lines(), found.text.len(), to.map(files::shown).unwrap_or_default());
    let document = Packed {
        name: found.pattern.name(),
        sha256: hash(found.text.as_bytes()),
        bytes: found.text.len(),
        waves: found.pattern.motions().iter().filter_map(wave).collect(),
    };
    give(json, &document, text)
}

fn wave(motion: &Motion) -> Option<PackedWave<'_>> {
    let Motion::Wave(wave) = motion else { return None };
    Some(PackedWave {
        motor: wave.motor,
        start_s: wave.start_s,
        rate_hz: wave.rate_hz,
        samples: wave.um.len(),
        source: wave.source.as_deref(),
    })
}

fn check(asked: &Check) -> Result<ExitCode> {
    asked.array.find()?;
    let pattern = pattern_file::of_argument(&asked.pattern)?.pattern;
    asked.array.check(&asked.pattern, pattern.array())?;
    let followed = Motions::of(&pattern, asked.scale)?;
    let problems = followed.as_ref().map(|of| of.problems(pattern.array())).unwrap_or_default();
    let outline = Outline::of(&pattern, &StrokeOptions { scale: asked.scale, ..StrokeOptions::default() })?;
    let saturated = pattern.saturated().map(|(_, line)| line);
    if asked.strict
        && let Some((first, more)) =
            problems.iter().cloned().chain(saturated).collect::<Vec<_>>().split_first()
    {
        let more = if more.is_empty() { String::new() } else { format!("; and {} more", more.len()) };
        bail!("{}: {first}{more}", pattern.name());
    }
    let document = Checked {
        name: pattern.name(),
        array: pattern.array().spec().name(),
        duration_s: pattern.duration_s(),
        drives: pattern.drives().len(),
        motions: pattern.motions().len(),
        followed,
        warnings: problems.into_iter().chain(outline.warnings).collect(),
    };
    give(asked.output.json, &document, || summary(&document))
}

fn summary(found: &Checked<'_>) -> String {
    let duration = found.duration_s.map_or_else(String::new, |seconds| format!(", {seconds} s"));
    let Checked { name, array, drives, motions, .. } = found;
    let mut lines = vec![format!("{name}{duration}, {drives} drives, {motions} motions, for {array}")];
    match &found.followed {
        Some(followed) => lines.push(text::motions(followed)),
        None => lines.push(
            "it has drives only: `meissner show NAME` and `meissner displacement` say what they reach"
                .to_owned(),
        ),
    }
    lines.extend(found.warnings.iter().map(|warning| format!("warning: {warning}")));
    lines.join("\n")
}
