//! `simulate` of a pattern: its drives and motions move the pins, and a fingertip of either model responds.
//!
//! The pattern is simulated burst by burst, as ideal motors play it. Afferents are a fingertip's population.

use super::afferents::{OfClass, Placed};
use super::arguments::Simulate;
use super::table::print_csv;
use crate::cli::files::{self, Kind};
use crate::cli::output::give;
use crate::cli::pattern_file::{self, Found};
use crate::cli::{progress, text};
use crate::receipts::fit;
use anyhow::{Result, bail};
use clap::error::ErrorKind;
use meissner_array::pattern::Pattern;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_skin::afferents::{Afferent, Class};
use meissner_skin::membrane::{AfferentModel, POPULATION_NOISE_SD, Rectify, population};
use meissner_skin::{Finger, ModelName, Ramps, Scene, simulate_ramps};
use serde::Serialize;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

/// The document of `simulate --json` of a pattern.
#[derive(Debug, Serialize)]
struct Document<'a> {
    model: ModelName,
    pattern: &'a str,
    seconds: f64,
    /// The seed of the fingertip and of the noise.
    seed: u64,
    drives: usize,
    motions: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    spikes_s: Option<&'a [Vec<f64>]>,
    rates_hz: Vec<f64>,
    afferents: Vec<Placed>,
    classes: Vec<OfClass>,
    wall_s: f64,
}

/// The pattern that the argument names, unless it is a scene's file.
pub(super) fn find(argument: &Path) -> Result<Option<Found>> {
    let shown = argument.to_string_lossy();
    if shown == "-" {
        return Ok(None);
    }
    if !files::is_file(&shown) && !argument.exists() {
        return pattern_file::of_argument(&shown).map(Some);
    }
    // Only the beginning is read: it says that it is a pattern.
    let mut beginning = Vec::new();
    let opened = crate::file::open_regular(argument);
    let read = opened.and_then(|file: File| file.take(1 << 16).read_to_end(&mut beginning));
    let is_pattern = read.is_ok() && Kind::of(&String::from_utf8_lossy(&beginning)) == Some(Kind::Pattern);
    if is_pattern { pattern_file::of_file(argument).map(Some) } else { Ok(None) }
}

pub(super) fn run(asked: &Simulate, pattern: &Pattern) -> Result<ExitCode> {
    if asked.names_a_method() {
        let message = "a pattern is simulated burst by burst: leave out --method, --step-us and --integrator, or name a scene";
        return Err(clap::Error::raw(ErrorKind::ArgumentConflict, message).into());
    }
    asked.array.check(&asked.scene.to_string_lossy(), pattern.array())?;
    let begun = Instant::now();
    let options = StrokeOptions {
        seconds: asked.seconds,
        scale: asked.scale,
        fit: fit(asked.fit),
        error_um: asked.error_um,
        ..StrokeOptions::default()
    };
    let strokes = Strokes::new(pattern, &options)?;
    let Some(end) = strokes.end() else {
        bail!("`{}` has no end: say for how long with --seconds", pattern.name());
    };
    let seconds = pattern.array().rate().ticks_to_seconds(end);
    let model = asked.model.unwrap_or(ModelName::Membrane);
    let (afferents, classes, spikes_s) = progress::waiting("simulating", || -> Result<_> {
        let ramps = Ramps::of_strokes(strokes, seconds)?;
        Ok(match model {
            ModelName::Membrane => {
                let (places, membrane) = (
                    population(asked.seed),
                    AfferentModel::default_for(Rectify::default(), POPULATION_NOISE_SD),
                );
                let rapid = |&at| Afferent { class: Class::Ra, row: 0, at };
                let afferents: Vec<_> = places.iter().map(rapid).collect();
                let scene = Scene::new(pattern.array(), seconds, asked.seed, Vec::new(), places, membrane)?;
                (afferents, &Class::ALL[1..2], simulate_ramps(&scene, &ramps)?)
            }
            ModelName::Afferents => {
                let finger = Finger::new(asked.seed);
                let spikes_s = finger.spikes_s(&ramps, seconds, asked.seed)?;
                (finger.afferents().to_vec(), &Class::ALL[..], spikes_s)
            }
        })
    })?;
    let counts: Vec<u64> = spikes_s.iter().map(|train| train.len() as u64).collect();
    let rates_hz: Vec<f64> =
        counts.iter().map(|&count| count as f64 / seconds.max(f64::MIN_POSITIVE)).collect();
    if asked.csv {
        let afferents = afferents.iter().map(|of| (of.class.name(), Some(of.row), of.at));
        return print_csv(afferents, &counts, &rates_hz);
    }
    let of_class = |&class: &Class| {
        let of_class = afferents.iter().zip(&rates_hz).filter(|(of, _)| of.class == class);
        let rates: Vec<f64> = of_class.map(|(_, &rate_hz)| rate_hz).collect();
        let mean_hz = rates.iter().sum::<f64>() / rates.len().max(1) as f64;
        OfClass { class, afferents: rates.len(), mean_hz, per_cm2: None }
    };
    let classes = classes.iter().map(of_class).collect();
    let document = Document {
        model,
        pattern: pattern.name(),
        seconds,
        seed: asked.seed,
        drives: pattern.drives().len(),
        motions: pattern.motions().len(),
        spikes_s: (!asked.rates_only).then_some(&spikes_s[..]),
        rates_hz,
        afferents: afferents.iter().map(Placed::of).collect(),
        classes,
        wall_s: begun.elapsed().as_secs_f64(),
    };
    give(asked.output.json, &document, || summary(&document, counts.iter().sum()))
}

fn summary(document: &Document<'_>, spikes: u64) -> String {
    let Document { drives, motions, rates_hz, seconds, .. } = document;
    let pairs = text::pairs(&[
        ("model", document.model.name().to_owned()),
        ("pattern", format!("{}, {drives} drives, {motions} motions", document.pattern)),
        ("afferents", format!("{}, for {seconds} s", rates_hz.len())),
        ("spikes", spikes.to_string()),
        ("wall time", format!("{:.3} s", document.wall_s)),
    ]);
    let row = |of: &OfClass| {
        vec![of.class.name().to_owned(), of.afferents.to_string(), format!("{:.1}", of.mean_hz)]
    };
    let classes = text::columns(&["class", "afferents", "mean impulses/s"], document.classes.iter().map(row));
    format!("{pairs}\n\n{classes}")
}
