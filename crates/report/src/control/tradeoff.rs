//! Measures all cells of a grid.
//!
//! Invariant: the same grid gives the same figures, on every machine and any number of cores.

use crate::control::grid::ControlGrid;
use crate::control::row::ControlRow;
use crate::control::summary::{ControlSummary, recommendation};
use crate::control::wire::Wire;
use meissner_array::motor::MotorError;
use meissner_stream::MotorRun;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicU64, Ordering};

/// The accuracy of rest positions and amplitudes under position control.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControlTradeoff {
    /// The cells of the grid, in order.
    pub rows: Vec<ControlRow>,
    /// Rest errors against the rate of telemetry.
    pub rates: Vec<ControlRow>,
    /// Bytes on the line with and without corrections.
    pub wire: Wire,
    /// The number of cells within their limits, and the worst.
    pub summary: ControlSummary,
    /// The recommended telemetry, in a few sentences.
    pub recommendation: String,
}

/// Measures each cell of a grid. `progress` gets the completed share, 0 to 1, on any thread.
///
/// # Errors
/// If a frequency or amplitude is out of range.
pub fn control_tradeoff(
    grid: &ControlGrid,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<ControlTradeoff, MotorError> {
    let (cells, rates) = (grid.cells(), grid.rates());
    // The work of a cell is proportional to its samples.
    let samples = |run: &MotorRun| grid.seconds(run) * run.telemetry_hz;
    let all: f64 = cells.iter().chain(&rates).map(samples).sum();
    let done = AtomicU64::new(0);
    let row = |run: &MotorRun| {
        let row = ControlRow::of(run, grid.seconds(run));
        let before = done.fetch_add(samples(run) as u64, Ordering::Relaxed);
        progress(((before as f64 + samples(run)) / all).min(1.0));
        row
    };
    let measure =
        |runs: Vec<MotorRun>| runs.par_iter().with_max_len(1).map(row).collect::<Result<Vec<_>, _>>();
    let (rows, rates) = (measure(cells)?, measure(rates)?);
    let wire = Wire::measure();
    let summary = ControlSummary::of(&rows);
    let recommendation = recommendation(&rows, &rates, &wire);
    Ok(ControlTradeoff { rows, rates, wire, summary, recommendation })
}
