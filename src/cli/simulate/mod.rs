//! `simulate`: simulates the afferents of a scene, by the model it names, or those of a fingertip on a pattern. It needs no daemon.
//!
//! Scenes of the first model are here, of the second in `afferents`; `pattern` has patterns. `label` names a method, `skipped` the work
//! that was not needed.
//!
//! Invariant: a scene that is too large is not read into memory.

mod afferents;
mod label;
mod pattern;
mod skipped;

pub(super) use afferents::Placed;
pub(super) use label::MethodLabel;

use crate::cli::arguments::{ArrayOption, FITS, Output, choice, positive};
use crate::cli::files::{self, Kind};
use crate::cli::output::give;
use crate::cli::{progress, text};
use anyhow::Result;
use clap::error::ErrorKind;
use clap::{Args, ValueEnum};
use meissner_api::Fit;
use meissner_skin::membrane::Position;
use meissner_skin::{
    Answer, AnyScene, Integrator, Keep, MAX_JSON_BYTES, Method, ModelName, Options, Scene, simulate,
};
use serde::Serialize;
use skipped::{Reason, reasons};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// The models of skin and afferents.
pub(super) const MODELS: &[(&str, &str)] = &[
    ("membrane", "RA afferents with a leaky membrane, Gaussian receptive fields"),
    ("afferents", "Skin under flat pins, and SA1, RA and PC afferents fitted to recordings; steps of 200 us"),
];
/// The default step, µs.
const STEP_US: u32 = 200;

#[derive(Debug, Args)]
pub(super) struct Simulate {
    /// Simulate this scene: a TOML or JSON file, or - for stdin; or this pattern: a name of the library, or a file
    scene: PathBuf,
    /// Choose the model of skin and afferents [default: the scene's key `model`, else membrane]
    #[arg(long, value_parser = choice::<ModelName>(MODELS))]
    model: Option<ModelName>,
    /// Choose the method [default: stepped if a step or integrator is given, else exact]
    #[arg(long, value_enum)]
    method: Option<Name>,
    /// Take steps of N us [default: 200]
    #[arg(long, value_name = "N")]
    step_us: Option<u32>,
    /// Choose how a step is integrated [default: propagator]
    #[arg(long, value_parser = choice::<Integrator>(&[("euler", "Use eq. 2 of the paper: input and leak at the step's start, a spike at its end"), ("propagator", "Use the exact leak, the mean input, and threshold crossings within the step")]))]
    integrator: Option<Integrator>,
    /// Simulate a pattern for S seconds: truncate or loop it
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = positive)]
    seconds: Option<f64>,
    /// Choose which strokes of a pattern are played at the end
    #[arg(long, default_value = "whole", value_parser = choice::<Fit>(FITS))]
    fit: Fit,
    /// Multiply the amplitude of every drive and motion of a pattern by X, 0 to 1
    #[arg(long, value_name = "X", default_value_t = 1.0, allow_negative_numbers = true, value_parser = positive)]
    scale: f64,
    /// Simulate a pattern on the fingertip N, with its noise
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    seed: u64,
    /// Let steps move pins at most UM um away from what the motors can do of a motion [default: the array's shortest burst]
    #[arg(long, value_name = "UM", allow_negative_numbers = true, value_parser = positive)]
    error_um: Option<f64>,
    /// Count spikes without keeping their times
    #[arg(long)]
    rates_only: bool,
    /// Print one row per afferent: its class, place, spikes and rate
    #[arg(long, conflicts_with = "json")]
    csv: bool,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    output: Output,
}

impl Simulate {
    /// Whether it asks for a method of the membrane.
    const fn names_a_method(&self) -> bool {
        self.method.is_some() || self.step_us.is_some() || self.integrator.is_some()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Name {
    /// Go from event to event, without a step
    Exact,
    /// Go by a fixed step
    Stepped,
}

/// The document of `simulate --json`.
#[derive(Debug, Serialize)]
struct Document<'a> {
    model: ModelName,
    #[serde(flatten)]
    how: MethodLabel,
    #[serde(skip_serializing_if = "Option::is_none")]
    spikes_s: Option<&'a [Vec<f64>]>,
    rates_hz: Vec<f64>,
    skipped: Vec<Reason>,
    wall_s: f64,
}

pub(super) fn run(asked: &Simulate) -> Result<ExitCode> {
    asked.array.find()?;
    if let Some(found) = pattern::find(&asked.scene)? {
        return pattern::run(asked, &found.pattern);
    }
    let method = method(asked)?;
    let is_scaled = asked.scale.to_bits() != 1.0_f64.to_bits() || asked.fit != Fit::Whole;
    if asked.seconds.is_some() || asked.error_um.is_some() || asked.seed != 0 || is_scaled {
        let message = "--seconds, --fit, --scale, --seed and --error-um are for patterns: a scene says its drives, its duration and its \
                       seed";
        return Err(clap::Error::raw(ErrorKind::ArgumentConflict, message).into());
    }
    let scene = read(&asked.scene, asked.model)?;
    asked.array.check(&files::shown(&asked.scene), scene.array())?;
    let scene = match scene {
        AnyScene::Membrane(scene) => scene,
        AnyScene::Afferents(scene) => return afferents::run(asked, &scene),
    };
    let begun = Instant::now();
    let keep = if asked.rates_only { Keep::Rates } else { Keep::Spikes };
    let options = Options { keep, ..Options::spikes(method) };
    let answer = progress::metered(|at| simulate(&scene, &options, at))?;
    if asked.csv {
        let rates = answer.rates_hz(&scene);
        let afferents = scene.afferents().iter().map(|&at| ("RA", None, at));
        return print_csv(afferents, &answer.counts, &rates);
    }
    let document = Document {
        model: ModelName::Membrane,
        how: method.into(),
        spikes_s: answer.spikes_s.as_deref(),
        rates_hz: answer.rates_hz(&scene),
        skipped: reasons(&answer.skipped),
        wall_s: begun.elapsed().as_secs_f64(),
    };
    give(asked.output.json, &document, || summary(&scene, &answer, &document))
}

/// The requested method. Contradictions are usage errors.
fn method(asked: &Simulate) -> Result<Method, clap::Error> {
    let implied = asked.step_us.is_some() || asked.integrator.is_some();
    if asked.method == Some(Name::Exact) && implied {
        let message =
            "the exact method has no step and no integrator: leave them out, or take --method stepped";
        return Err(clap::Error::raw(ErrorKind::ArgumentConflict, message));
    }
    let integrator = asked.integrator.unwrap_or_default();
    let step_us = asked.step_us.unwrap_or(STEP_US);
    let stepped = implied || asked.method == Some(Name::Stepped);
    Ok(if stepped { Method::stepped(step_us, integrator) } else { Method::Exact })
}

/// Reads a scene of either model from a file, or from stdin.
pub(super) fn read(file: &Path, model: Option<ModelName>) -> Result<AnyScene> {
    let (text, name) = files::text_or_stdin(file, MAX_JSON_BYTES as u64, "a scene")?;
    Kind::Scene.check(&text, &name)?;
    Ok(AnyScene::read(&text, &name, model)?)
}

/// Prints a row per afferent, in the scene's order. An afferent is its class, its row of parameters and its place.
fn print_csv(
    afferents: impl Iterator<Item = (&'static str, Option<u8>, Position)>,
    counts: &[u64],
    rates_hz: &[f64],
) -> Result<ExitCode> {
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(["afferent", "class", "row", "x_mm", "y_mm", "spikes", "rate_hz"])?;
    for (number, ((class, row, at), (count, rate_hz))) in
        afferents.zip(counts.iter().zip(rates_hz)).enumerate()
    {
        table.serialize((number, class, row, at.x_mm, at.y_mm, count, rate_hz))?;
    }
    let text = String::from_utf8(table.into_inner()?)?;
    give(false, &(), || text.trim_end().to_owned())
}

fn summary(scene: &Scene, answer: &Answer, document: &Document<'_>) -> String {
    let rates = &document.rates_hz;
    let mean = rates.iter().sum::<f64>() / rates.len().max(1) as f64;
    let (least, most) =
        rates.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), &rate| (least.min(rate), most.max(rate)));
    let rate = if rates.is_empty() {
        "-".to_owned()
    } else {
        format!("mean {mean:.1} impulses/s, {least:.1} to {most:.1}")
    };
    let mut lines = vec![
        ("model", document.model.name().to_owned()),
        ("afferents", format!("{}, for {} s", rates.len(), scene.duration_s())),
        ("method", document.how.to_string()),
        ("spikes", answer.counts.iter().sum::<u64>().to_string()),
        ("rate", rate),
        ("wall time", format!("{:.3} s", document.wall_s)),
    ];
    if document.skipped.is_empty() {
        lines.push(("skipped", "nothing".to_owned()));
        return text::pairs(&lines);
    }
    let row = |reason: &Reason| {
        vec![reason.what.replace('_', " "), reason.count.to_string(), reason.why.to_string()]
    };
    let skipped = text::columns(&["skipped", "count", "why"], document.skipped.iter().map(row));
    format!("{}\n\n{skipped}", text::pairs(&lines))
}
