//! `tradeoff`: compares simulation methods on a scene by measurement, time against error, and with the second model its computing
//! times ([`afferents`]). It needs no daemon. `meissner_report` measures and recommends; this module prints.

mod afferents;

use super::arguments::{ArrayOption, Output, choice};
use super::output::give;
use super::simulate::{self, MODELS};
use super::text::number;
use super::{files, progress, text};
use anyhow::Result;
use clap::Args;
use meissner_design::YARDSTICK;
use meissner_skin::{AnyScene, ModelName};
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct MethodTradeoff {
    /// Compare methods on this scene: a TOML or JSON file, or - for stdin [default: all motors at 60 Hz, 1 s]
    scene: Option<PathBuf>,
    /// Choose the model of skin and afferents [default: the scene's key `model`, else membrane]
    #[arg(long, value_parser = choice::<ModelName>(MODELS))]
    model: Option<ModelName>,
    /// Draw the comparison into FILE (SVG)
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    output: Output,
}

pub(super) fn run(asked: &MethodTradeoff) -> Result<ExitCode> {
    asked.array.find()?;
    let scene = match &asked.scene {
        Some(file) => simulate::read(file, asked.model)?,
        None => AnyScene::read(meissner_report::SIXTY_HERTZ, "sixty-hertz.toml", asked.model)?,
    };
    let name = asked.scene.as_deref().map_or_else(|| "sixty-hertz.toml".to_owned(), files::shown);
    asked.array.check(&name, scene.array())?;
    let scene = match scene {
        AnyScene::Membrane(scene) => scene,
        AnyScene::Afferents(scene) => return afferents::compare(asked, &scene),
    };
    // This reports an unwritable place before the work.
    let plot = asked.plot.as_deref().map(files::beside).transpose()?;
    let found = progress::metered(|at| meissner_report::tradeoff(&scene, at))?;
    if let Some(plot) = plot {
        plot.write(&meissner_report::plot(&found))?;
    }
    give(asked.output.json, &found, || {
        let mut lines = methods_table(&found);
        lines.extend(asked.plot.iter().map(|file| format!("plot  {}", files::shown(file))));
        lines.join("\n")
    })
}

fn methods_table(tradeoff: &meissner_report::MethodTradeoff) -> Vec<String> {
    let head = [
        "method",
        "us/afferent/s",
        "matched",
        "error us",
        "rate RMS",
        "rate bias",
        "contrast error",
        "front",
    ];
    let row = |row: &meissner_report::Row| {
        let front = match (&row.reason, row.pareto) {
            (Some(_), _) => "refused",
            (None, true) => "*",
            (None, false) => "",
        };
        vec![
            row.method.to_string(),
            number(row.us_per_afferent_s, 2),
            number(row.difference.spikes_matched_share, 4),
            number(row.difference.mean_error_us, 1),
            number(row.difference.rate_rms_hz, 3),
            number(row.difference.rate_bias, 5),
            number(row.difference.cost_error_hz, 3),
            front.to_owned(),
        ]
    };
    let scene = format!(
        "{} afferents for {} s, {} spikes; the exact method took {:.3} s; rates and contrast in impulses/s",
        tradeoff.afferents, tradeoff.duration_s, tradeoff.spikes, tradeoff.exact_wall_s
    );
    let mut lines = vec![scene, text::columns(&head, tradeoff.rows.iter().map(row))];
    lines.push(format!(
        "Contrast (exact: {}): mean rate of the afferents within 1.5 mm of the edge minus mean rate of the others, which \
         `meissner optimise` maximises. The edge is the target `{YARDSTICK}`, 12 mm long, at 45 degrees through the \
         array's middle; - if there are no afferents on one side.",
        number(tradeoff.cost_hz, 3)
    ));
    // Rows may share a reason, for example Euler's in f32 and f64.
    for reason in tradeoff.rows.iter().filter_map(|row| row.reason.as_ref()) {
        let line = format!("Refused: {reason}.");
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    if tradeoff.rows.iter().any(|row| row.unstable) {
        lines.push(format!(
            "With steps between tau ({} s) and 2 tau explicit Euler alternates in sign; above 2 tau it diverges. Steps \
             above tau are refused.",
            tradeoff.tau_s
        ));
    }
    if let Some(left_out) = &tradeoff.left_out {
        let steps: Vec<_> = left_out.steps_us.iter().map(ToString::to_string).collect();
        lines.push(format!("Left out: {} us, {}.", steps.join(", "), left_out.why));
    }
    lines.push(tradeoff.recommendation.clone());
    lines
}
