//! The rest error against the surplus as SVG: the theory as lines, the simulation as points.
//!
//! Invariant: the same figures make the same bytes.

use crate::chart::{Axis, Chart, PlotError, Point, Scale, Series, stacked};
use crate::stop::row::StopRow;
use crate::stop::tradeoff::StopTradeoff;
use meissner_array::reflected_walk::{ReflectedWalk, Spread};

/// The charts are for this frequency and amplitude, if the grid has them.
const FREQUENCY_HZ: f64 = 60.0;
const AMPLITUDE_UM: f64 = 80.0;
/// Points of a line.
const STEPS: u32 = 120;
/// The largest surplus of a line, µm.
const MOST_UM: f64 = 30.0;

/// Draws rest errors against the surplus, without asymmetry and over motors with asymmetry; returns the text of an SVG file.
///
/// # Errors
/// If the drawing library fails.
pub fn plot_stop(tradeoff: &StopTradeoff) -> Result<String, PlotError> {
    let mut asymmetries: Vec<f64> = tradeoff.rows.iter().map(|row| row.cell.asymmetry_sd).collect();
    asymmetries.sort_by(f64::total_cmp);
    asymmetries.dedup();
    let titles: Vec<String> = asymmetries
        .iter()
        .map(|sd| format!("Rest error at 60 Hz, 80 µm, asymmetry SD {sd} (points: simulated; lines: theory, symmetric motor)"))
        .collect();
    let charts: Vec<Chart<'_>> =
        titles.iter().zip(asymmetries).map(|(title, sd)| chart(title, &tradeoff.rows, sd)).collect();
    stacked(&charts)
}

/// A series for each scatter.
fn chart<'a>(title: &'a str, rows: &[StopRow], asymmetry_sd: f64) -> Chart<'a> {
    let here = |row: &&StopRow| {
        let cell = &row.cell;
        (cell.frequency_hz, cell.amplitude_um, cell.asymmetry_sd)
            == (FREQUENCY_HZ, AMPLITUDE_UM, asymmetry_sd)
    };
    let mut scatters: Vec<f64> = rows.iter().filter(here).map(|row| row.cell.scatter).collect();
    scatters.dedup();
    let series = |scatter: f64| {
        let rows = rows.iter().filter(here).filter(|row| row.cell.scatter == scatter && row.surplus_um > 0.0);
        let points =
            rows.map(|row| Point { x: row.surplus_um, y: row.rest_rms_um, sd: row.rest_se_um }).collect();
        let line = (1..=STEPS).map(|step| {
            let um = f64::from(step) / f64::from(STEPS) * MOST_UM;
            (um, ReflectedWalk::new(AMPLITUDE_UM, um, Spread { scatter, asymmetry: 0.0 }).rms_um())
        });
        Series { points, ..Series::line(format!("scatter {scatter}"), line.collect()) }
    };
    Chart {
        title: Some(title),
        x: Axis { name: "surplus of a down burst, µm", scale: Scale::linear(0.0, MOST_UM) },
        y: Axis { name: "rest error, µm RMS", scale: Scale::logarithmic(0.1, 1000.0).broken("below") },
        series: scatters.into_iter().map(series).collect(),
    }
}
