//! Measures all cells of a grid.
//!
//! Invariant: the same grid gives the same figures, on every machine and any number of cores.

use crate::stop::edge::array;
use crate::stop::grid::{StopCell, StopGrid};
use crate::stop::response::{Contrasts, StopError, contrasts, edge};
use crate::stop::row::{StopReason, StopRow};
use meissner_array::simulated::LowerStop;
use meissner_array::strokes::StrokeOptions;
use meissner_stream::{MotorRun, rest_bound_um};
use rayon::prelude::*;
use serde::Serialize;

/// The rest error above a lower stop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StopTradeoff {
    /// The bound of the worst motor's rest error under the automatic surplus, RMS, µm.
    pub rest_error_um: f64,
    /// Simulated motors of a cell.
    pub motors: usize,
    /// Strokes of each motor.
    pub strokes: usize,
    /// The number of first strokes that do not count.
    pub settling: usize,
    /// The cells of the grid, in order.
    pub rows: Vec<StopRow>,
    /// The number of cells that differ from the theory, by reason.
    pub reasons: Vec<StopCount>,
}

/// Cells that differ from the theory for a reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct StopCount {
    /// The reason; none: they agree within 10 %.
    pub reason: Option<StopReason>,
    /// The number of cells.
    pub cells: usize,
}

/// Measures each cell of a grid.
///
/// # Errors
/// If a frequency or amplitude is out of range.
pub fn stop_tradeoff(grid: &StopGrid) -> Result<StopTradeoff, StopError> {
    let groups = grid.groups();
    let measured = groups.par_iter().with_max_len(1).map(|cells| group(cells, grid));
    let rows = measured.collect::<Result<Vec<_>, _>>()?.concat();
    let mut reasons: Vec<StopCount> = Vec::new();
    for row in &rows {
        match reasons.iter_mut().find(|count| count.reason == row.reason) {
            Some(count) => count.cells += 1,
            None => reasons.push(StopCount { reason: row.reason, cells: 1 }),
        }
    }
    reasons.sort_by_key(|count| count.reason);
    let StopGrid { rest_error_um, strokes, settling, .. } = *grid;
    let motors = rows.first().map_or(0, |_| grid.arrays as usize * array().motors());
    Ok(StopTradeoff { rest_error_um, motors, strokes, settling, rows, reasons })
}

/// Measures the cells that differ in their surplus only.
fn group(cells: &[StopCell], grid: &StopGrid) -> Result<Vec<StopRow>, StopError> {
    let Some(first) = cells.first() else { return Ok(Vec::new()) };
    let pattern = edge(first);
    let seconds = grid.response_s.max(2.0 / first.frequency_hz);
    let respond =
        |options: &StrokeOptions, stop| contrasts(&pattern, options, &first.motors(0, stop), seconds);
    let [designed, without_stop] = respond(&StrokeOptions::default(), LowerStop::None)?;
    let run = MotorRun::of(array());
    let bound_um = |travel_um| {
        let (delay_ms, telemetry_hz) = (run.delay_ms(), run.telemetry_hz);
        rest_bound_um(array(), first.frequency_hz, travel_um, first.scatter, delay_ms, telemetry_hz)
    };
    let row = |cell: &StopCell| {
        let [_, with_stop] = respond(&cell.options(grid.rest_error_um), LowerStop::AtRest)?;
        StopRow::of(cell, grid, bound_um, Contrasts { designed, with_stop, without_stop })
    };
    cells.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stop::grid::StopSurplus;
    use rayon::ThreadPoolBuilder;

    #[test]
    fn figures_are_the_same_on_any_number_of_cores_and_say_what_did_not_fit() {
        let grid = StopGrid {
            frequencies_hz: vec![60.0, 150.0],
            amplitudes_um: vec![80.0],
            scatters: vec![0.1],
            asymmetry_sds: vec![0.02],
            surpluses: vec![StopSurplus::Um(0.0), StopSurplus::Auto],
            arrays: 1,
            strokes: 400,
            settling: 100,
            response_s: 0.2,
            ..StopGrid::default()
        };
        let on = |threads| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| stop_tradeoff(&grid)).unwrap()
        };
        let found = on(1);
        assert_eq!(found, on(3));
        assert_eq!((found.motors, found.rows.len()), (24, 4));
        assert_eq!(found.reasons.iter().map(|count| count.cells).sum::<usize>(), 4);
        let [full, stopped, saturated, lowered] = &found.rows[..] else { panic!() };
        assert_eq!((full.reached_um, full.surplus_um), (stopped.reached_um, 0.0));
        assert!(stopped.rest_rms_um < 0.1 * full.rest_rms_um, "{found:?}");
        assert!(lowered.reached_um < saturated.reached_um - 1.0 && lowered.surplus_um > 1.0, "{found:?}");
        assert!(full.pushed_share < stopped.pushed_share && stopped.pushed_share < 0.5, "{found:?}");
        let text = serde_json::to_value(&found).unwrap();
        assert_eq!(
            (text["rows"][1]["surplus"].as_str(), text["rows"][0]["surplus"].as_f64()),
            (Some("auto"), Some(0.0))
        );
    }
}
