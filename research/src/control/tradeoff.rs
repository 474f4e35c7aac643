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

/// Measures each cell of a grid.
///
/// # Errors
/// If a frequency or amplitude is out of range.
pub fn control_tradeoff(grid: &ControlGrid) -> Result<ControlTradeoff, MotorError> {
    let (cells, rates) = (grid.cells(), grid.rates());
    let row = |run: &MotorRun| ControlRow::of(run, grid.seconds(run));
    let measure =
        |runs: Vec<MotorRun>| runs.par_iter().with_max_len(1).map(row).collect::<Result<Vec<_>, _>>();
    let (rows, rates) = (measure(cells)?, measure(rates)?);
    let wire = Wire::measure();
    let summary = ControlSummary::of(&rows);
    let recommendation = recommendation(&rows, &rates, &wire);
    Ok(ControlTradeoff { rows, rates, wire, summary, recommendation })
}
