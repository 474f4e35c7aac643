//! The table of `simulate --csv`.

use crate::cli::output::give;
use anyhow::Result;
use meissner_skin::membrane::Position;
use std::process::ExitCode;

/// Prints a row per afferent, in the scene's order. An afferent is its class, its row of parameters and its place.
pub(super) fn print_csv(
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
