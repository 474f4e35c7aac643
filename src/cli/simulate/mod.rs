//! `simulate`: simulates the afferents of a scene, by the model it names, or those of a fingertip on a pattern. It needs no daemon.
//!
//! Scenes of the first model are here, of the second in `afferents`; `pattern` has patterns. `label` names a method, `skipped` the work
//! that was not needed.
//!
//! Invariant: a scene that is too large is not read into memory.

mod afferents;
mod arguments;
mod label;
mod pattern;
mod skipped;
mod table;

pub(super) use afferents::Placed;
pub(super) use arguments::{MODELS, Simulate};
pub(super) use label::MethodLabel;

use crate::cli::files::{self, Kind};
use crate::cli::output::give;
use crate::cli::{progress, text};
use anyhow::Result;
use arguments::{Name, STEP_US};
use clap::error::ErrorKind;
use meissner_skin::{Answer, AnyScene, Keep, MAX_JSON_BYTES, Method, ModelName, Options, Scene, simulate};
use serde::Serialize;
use skipped::{Reason, reasons};
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;
use table::print_csv;

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
    let is_scaled = asked.scale.to_bits() != 1.0_f64.to_bits() || asked.fit != meissner_api::Fit::Whole;
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
