//! `simulate` by the second model, and its answer.

use super::arguments::Simulate;
use super::table::print_csv;
use crate::cli::output::give;
use crate::cli::{progress, text};
use anyhow::Result;
use clap::error::ErrorKind;
use meissner_skin::afferents::{Afferent, Class, LOWER_PER_CM2, SAMPLE_US, Scene, UPPER_PER_CM2, simulate};
use meissner_skin::{Keep, ModelName};
use serde::Serialize;
use std::process::ExitCode;
use std::time::Instant;

/// The document of `simulate --json`.
#[derive(Debug, Serialize)]
struct Document<'a> {
    model: ModelName,
    method: &'static str,
    step_us: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    spikes_s: Option<&'a [Vec<f64>]>,
    rates_hz: Vec<f64>,
    /// In the scene's order.
    afferents: Vec<Placed>,
    classes: Vec<OfClass>,
    /// How long each pin had lost contact with the skin.
    lost_contact_s: &'a [f64],
    wall_s: f64,
}

/// An afferent.
#[derive(Debug, Serialize)]
pub(in crate::cli) struct Placed {
    class: Class,
    row: u8,
    x_mm: f64,
    y_mm: f64,
}

impl Placed {
    pub(in crate::cli) fn of(&Afferent { class, row, at }: &Afferent) -> Self {
        Self { class, row, x_mm: at.x_mm, y_mm: at.y_mm }
    }
}

/// The afferents of a class.
#[derive(Debug, Serialize)]
pub(super) struct OfClass {
    pub(super) class: Class,
    pub(super) afferents: usize,
    pub(super) mean_hz: f64,
    /// Of a population: afferents per cm² of the pad's upper and lower half.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) per_cm2: Option<[f64; 2]>,
}

pub(super) fn run(asked: &Simulate, scene: &Scene) -> Result<ExitCode> {
    if asked.names_a_method() {
        let message = "the model afferents has steps of 200 us and no other method: leave out --method, --step-us and \
                       --integrator, or take --model membrane";
        return Err(clap::Error::raw(ErrorKind::ArgumentConflict, message).into());
    }
    let begun = Instant::now();
    let keep = if asked.rates_only { Keep::Rates } else { Keep::Spikes };
    let answer = progress::metered(|at| simulate(scene, keep, at))?;
    let rates_hz = answer.rates_hz(scene);
    if asked.csv {
        let afferents = scene.afferents().iter().map(|of| (of.class.name(), Some(of.row), of.at));
        return print_csv(afferents, &answer.counts, &rates_hz);
    }
    let of_class = |class: Class| {
        let mean_hz = answer.mean_hz(scene, class)?;
        let afferents = scene.afferents().iter().filter(|afferent| afferent.class == class).count();
        let index = class as usize;
        let per_cm2 = scene.has_population().then_some([UPPER_PER_CM2[index], LOWER_PER_CM2[index]]);
        Some(OfClass { class, afferents, mean_hz, per_cm2 })
    };
    let document = Document {
        model: ModelName::Afferents,
        method: "stepped",
        step_us: SAMPLE_US,
        spikes_s: answer.spikes_s.as_deref(),
        rates_hz,
        afferents: scene.afferents().iter().map(Placed::of).collect(),
        classes: Class::ALL.into_iter().filter_map(of_class).collect(),
        lost_contact_s: &answer.lost_contact_s,
        wall_s: begun.elapsed().as_secs_f64(),
    };
    give(asked.output.json, &document, || summary(scene, answer.counts.iter().sum(), &document))
}

fn summary(scene: &Scene, spikes: u64, document: &Document<'_>) -> String {
    let lost: Vec<f64> = document.lost_contact_s.iter().copied().filter(|&lost_s| lost_s > 0.0).collect();
    let contact = match lost.iter().copied().fold(0.0, f64::max) {
        0.0 => "all pins, all the time".to_owned(),
        longest => format!(
            "{} of {} pins lost it, for up to {longest:.3} s",
            lost.len(),
            document.lost_contact_s.len()
        ),
    };
    let pairs = text::pairs(&[
        ("model", document.model.name().to_owned()),
        ("afferents", format!("{}, for {} s", document.rates_hz.len(), scene.duration_s())),
        ("method", format!("steps of {SAMPLE_US} us")),
        ("spikes", spikes.to_string()),
        ("contact", contact),
        ("wall time", format!("{:.3} s", document.wall_s)),
    ]);
    if document.classes.is_empty() {
        return pairs;
    }
    let row = |of: &OfClass| {
        vec![of.class.name().to_owned(), of.afferents.to_string(), format!("{:.1}", of.mean_hz)]
    };
    let classes = text::columns(&["class", "afferents", "mean impulses/s"], document.classes.iter().map(row));
    format!("{pairs}\n\n{classes}")
}
