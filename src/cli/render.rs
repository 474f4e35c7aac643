//! `render`: makes a pattern that gives a finger the response that a real object gives. It needs no daemon.
//!
//! Invariant: an existing file is replaced only by a whole pattern.

use super::arguments::{Output, PaperArrayOption, choice};
use super::output::{is_broken_pipe, say, say_file, say_json, tell};
use super::{files, object, progress, text};
use crate::rendering::{self, METHODS, levels, provenance};
use anyhow::{Result, anyhow, bail};
use clap::Args;
use meissner_api::RenderMethod;
use meissner_array::spec::Array;
use meissner_input::message::escape;
use meissner_render::{Choice, Levels, TRACE_MM_S};
use meissner_touch::{Contact, Object};
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// The speeds of a trace, mm/s.
const TRACES_MM_S: std::ops::RangeInclusive<f64> = 1.0..=200.0;

#[derive(Debug, Args)]
pub(super) struct Render {
    /// Render this object: a file (TOML with kind = "object"), or the name of a shipped one
    object: String,
    /// Write the pattern to PATTERN and name it after the file [default: stdout]
    #[arg(short = 'o', long = "output", value_name = "PATTERN")]
    file: Option<PathBuf>,
    /// Choose how heights are found
    #[arg(long, default_value = "auto", value_parser = choice::<RenderMethod>(METHODS))]
    method: RenderMethod,
    /// Trace at MM_S mm/s, 1 to 200, with `--method trace` [default: 40]
    #[arg(long, value_name = "MM_S", allow_negative_numbers = true)]
    trace_mm_s: Option<f64>,
    #[command(flatten)]
    array: PaperArrayOption,
    #[command(flatten)]
    output: Output,
}

#[derive(Debug, Serialize)]
struct Document<'a> {
    object: &'a str,
    file: Option<String>,
    method: RenderMethod,
    grains: usize,
    pitch_mm: f64,
    duration_s: f64,
    motors: usize,
    highest_um: f64,
    contact_s: f64,
    wall_s: f64,
    /// What `auto` has chosen, and how near each answer comes.
    choice: Option<&'a Choice>,
    pattern: String,
}

pub(super) fn run(asked: &Render) -> Result<ExitCode> {
    let begun = Instant::now();
    let array = asked.array.find()?;
    if let Some(file) = asked.file.as_deref().filter(|file| files::is_itself(&asked.object, file)) {
        bail!("{}: this is the object's file: write the pattern to another", files::shown(file));
    }
    let (object, contact) = object::of_argument(&asked.object)?;
    let contact_s = begun.elapsed().as_secs_f64();
    let name = match &asked.file {
        Some(file) => {
            drop(files::beside(file)?);
            files::pattern_name(file)?
        }
        None => object.name().to_owned(),
    };
    let (levels, choice) = progress::waiting("rendering", || heights(asked, array, &object, &contact))?;
    let keys = object::keys(&asked.object, object.name())?;
    let provenance =
        provenance(keys, asked.method, contact.grains().pitch_mm, asked.trace_mm_s, choice.as_ref())?;
    let pattern = rendering::pattern(&levels, array, &name, provenance)
        .map_err(|error| anyhow!("{}: {error}", asked.object))?;
    let text = pattern.to_toml();
    if let Some(file) = &asked.file {
        files::beside(file)?.write(&text)?;
    }
    let document = Document {
        object: object.name(),
        file: asked.file.as_ref().map(|file| file.to_string_lossy().into_owned()),
        method: asked.method,
        grains: contact.grains().len(),
        pitch_mm: contact.grains().pitch_mm,
        duration_s: pattern.duration_s().unwrap_or(0.0),
        motors: pattern.motions().len(),
        highest_um: pattern.largest_um(),
        contact_s,
        wall_s: begun.elapsed().as_secs_f64(),
        choice: choice.as_ref(),
        pattern: text,
    };
    let said = match (asked.output.json, &asked.file) {
        (true, _) => say_json(&document),
        (false, Some(_)) => say(&summary(&document)),
        (false, None) => {
            let said = say_file(document.pattern.trim_end());
            // Ignore a closed stderr: the pattern matters more.
            tell(&summary(&document));
            said
        }
    };
    said.or_else(|error| if is_broken_pipe(&error) { Ok(()) } else { Err(error) })?;
    Ok(ExitCode::SUCCESS)
}

/// The heights of the method that was asked for.
fn heights(
    asked: &Render,
    array: Array,
    object: &Object,
    contact: &Contact,
) -> Result<(Levels, Option<Choice>)> {
    let speed_mm_s = asked.trace_mm_s.unwrap_or(TRACE_MM_S);
    match asked.method {
        RenderMethod::Trace if !TRACES_MM_S.contains(&speed_mm_s) => {
            bail!("--trace-mm-s {speed_mm_s}: must be 1 to 200 mm/s");
        }
        RenderMethod::Trace => {}
        _ if asked.trace_mm_s.is_some() => {
            bail!("--trace-mm-s: only a trace has a speed: leave it out, or add --method trace");
        }
        _ => {}
    }
    levels(array, object, contact, asked.method, speed_mm_s)
        .map_err(|error| anyhow!("{}: {error}", asked.object))
}

fn summary(document: &Document<'_>) -> String {
    let Document { object, grains, pitch_mm, duration_s, motors, highest_um, contact_s, wall_s, .. } =
        document;
    let mut pairs = vec![
        ("object", format!("{}, {grains} grains of {pitch_mm:.3} mm", escape(object))),
        ("pattern", format!("{duration_s:.3} s, {motors} pins, up to {highest_um:.0} um")),
        ("time", format!("{wall_s:.3} s, of which the contact took {contact_s:.3}")),
    ];
    if let Some(Choice { taken, likeness }) = document.choice {
        let all: Vec<_> = likeness.iter().map(|(name, likeness)| format!("{name} {likeness:.2}")).collect();
        pairs.push((
            "likeness",
            format!("{} ({taken} is taken; the object felt again has some 0.8)", all.join(", ")),
        ));
    }
    if let Some(file) = &document.file {
        pairs.push(("written", escape(file)));
    }
    text::pairs(&pairs)
}
