//! `tradeoff`: compares simulation methods on a scene, time against error. It needs no daemon.
//!
//! The first model has methods and steps: `methods` runs a scene by each of them, and `compare` compares its spikes and rates with the
//! exact ones. The second model has one method with one step: `afferents` measures its time, and its answers at the extremes.

mod afferents;
mod compare;
mod methods;

use super::arguments::{ArrayOption, Output, choice};
use super::output::give;
use super::simulate::{self, MODELS};
use super::text::{columns, number};
use super::{files, progress};
use anyhow::Result;
use clap::Args;
use meissner_skin::{AnyScene, ModelName};
use methods::{MethodTradeoff, Row};
use std::path::PathBuf;
use std::process::ExitCode;

/// All motors of the paper's array at 60 Hz, 306 afferents, 1 s.
const SIXTY_HERTZ: &str = include_str!("../../../library/scenes/sixty-hertz.toml");

#[derive(Debug, Args)]
pub(super) struct Tradeoff {
    /// Compare methods on this scene: a TOML or JSON file, or - for stdin [default: all motors at 60 Hz, 1 s]
    scene: Option<PathBuf>,
    /// Choose the model of skin and afferents [default: the scene's key `model`, else membrane]
    #[arg(long, value_parser = choice::<ModelName>(MODELS))]
    model: Option<ModelName>,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    output: Output,
}

pub(super) fn run(asked: &Tradeoff) -> Result<ExitCode> {
    asked.array.find()?;
    let scene = match &asked.scene {
        Some(file) => simulate::read(file, asked.model)?,
        None => AnyScene::read(SIXTY_HERTZ, "sixty-hertz.toml", asked.model)?,
    };
    let name = asked.scene.as_deref().map_or_else(|| "sixty-hertz.toml".to_owned(), files::shown);
    asked.array.check(&name, scene.array())?;
    match scene {
        AnyScene::Membrane(scene) => {
            let found = progress::metered(|at| methods::compare(&scene, at))?;
            give(asked.output.json, &found, || table(&found))
        }
        AnyScene::Afferents(scene) => {
            let found = progress::metered(|at| afferents::measure(&scene, at))?;
            give(asked.output.json, &found, || afferents::table(&found))
        }
    }
}

fn table(found: &MethodTradeoff) -> String {
    let head = ["method", "us/afferent/s", "matched", "error us", "rate RMS", "rate bias", "stable"];
    let row = |row: &Row| {
        let stable = match &row.reason {
            Some(_) if row.unstable => "no: refused",
            Some(_) => "refused",
            None => "yes",
        };
        vec![
            row.method.to_string(),
            number(row.us_per_afferent_s, 2),
            number(row.difference.spikes_matched_share, 4),
            number(row.difference.mean_error_us, 1),
            number(row.difference.rate_rms_hz, 3),
            number(row.difference.rate_bias, 5),
            stable.to_owned(),
        ]
    };
    let mut lines = vec![
        format!(
            "{} afferents for {} s, {} spikes; the exact method took {:.3} s; rates in impulses/s",
            found.afferents, found.duration_s, found.spikes, found.exact_wall_s
        ),
        columns(&head, found.rows.iter().map(row)),
    ];
    lines.extend(found.rows.iter().filter_map(|row| Some(format!("Refused: {}.", row.reason.as_ref()?))));
    if found.rows.iter().any(|row| row.unstable) {
        lines.push(format!(
            "With steps between tau ({} s) and 2 tau explicit Euler alternates in sign; above 2 tau it diverges. Steps \
             above tau are refused.",
            found.tau_s
        ));
    }
    if let Some(left_out) = &found.left_out {
        let steps: Vec<_> = left_out.steps_us.iter().map(ToString::to_string).collect();
        lines.push(format!("Left out: {} us, {}.", steps.join(", "), left_out.why));
    }
    lines.join("\n")
}
