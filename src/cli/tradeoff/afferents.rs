//! `tradeoff` under the second model: its computing times, and its extremes.

use super::MethodTradeoff;
use crate::cli::output::give;
use crate::cli::progress;
use crate::cli::text::{columns, number};
use anyhow::Result;
use clap::error::ErrorKind;
use meissner_report::{AfferentsRow, AfferentsTradeoff, Extreme, afferents_tradeoff};
use meissner_skin::afferents::{SAMPLE_US, Scene};
use std::process::ExitCode;

pub(super) fn compare(asked: &MethodTradeoff, scene: &Scene) -> Result<ExitCode> {
    if asked.plot.is_some() {
        let message = "the model afferents has one method, so there is nothing to draw: leave out --plot, or take --model membrane";
        return Err(clap::Error::raw(ErrorKind::ArgumentConflict, message).into());
    }
    let found = progress::metered(|at| afferents_tradeoff(scene, at))?;
    give(asked.output.json, &found, || table(&found))
}

fn table(found: &AfferentsTradeoff) -> String {
    let ms = |s: Option<f64>| number(s.map(|s| 1e3 * s), 2);
    let row = |row: &AfferentsRow| {
        vec![
            row.method.clone(),
            row.afferents.to_string(),
            ms(Some(row.wall_s)),
            ms(row.one_motor_wall_s),
            number(row.rate_rms_hz, 3),
            number(row.rate_bias.map(|share| 100.0 * share), 1),
        ]
    };
    let rows = columns(
        &["answer", "afferents", "time, ms", "one motor changed, ms", "rate RMS, impulses/s", "bias %"],
        found.rows.iter().map(row),
    );
    let row = |row: &Extreme| {
        let [sa1, ra, pc] = row.mean_hz;
        vec![
            row.scene.to_owned(),
            row.afferents.to_string(),
            format!("{:.2}", row.us_per_afferent_s),
            number(sa1, 1),
            number(ra, 1),
            number(pc, 1),
            format!("{:.1}", 100.0 * row.lost_contact),
            row.spikes.to_string(),
            row.nudged.to_string(),
        ]
    };
    let extremes = columns(
        &["scene", "afferents", "us/afferent/s", "SA1", "RA", "PC", "no contact %", "spikes", "nudged"],
        found.extremes.iter().map(row),
    );
    let steps = format!(
        "The step of {SAMPLE_US} us is part of the model: its noise and its filters go by samples, and its parameters were fitted \
         with it. A finer or coarser step would be another model, not a better or worse answer of this one. What it costs: \
         spikes come at whole steps, and no vibration may be faster than 2500 Hz."
    );
    [
        format!("A scene of {} s under the model afferents, on all cores. The rates of RA afferents are compared with the model's.", found.duration_s),
        rows,
        "Nearly: the search's evaluation, for RA afferents while all pins touch the skin; a motor whose influence on an afferent is \
         below the given share of the largest is left out.".to_owned(),
        "At the extremes, all pins at 60 Hz if nothing else is said. Nudged: afferents with another spike train if the skin is pressed in by a \
         picometre more."
            .to_owned(),
        extremes,
        steps,
    ]
    .join("\n")
}
