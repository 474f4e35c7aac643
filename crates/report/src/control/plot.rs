//! The rest error against the age and the rate of telemetry as SVG: bounds as lines, measurements as points.
//!
//! Where bursts do not fit into half a period, they are shorter than planned, so they scatter less than the bound assumes.
//!
//! Invariant: the same figures make the same bytes.

use crate::chart::{Axis, Chart, PlotError, Point, Scale, Series, stacked};
use crate::control::row::ControlRow;
use crate::control::summary::yardstick;
use crate::control::tradeoff::ControlTradeoff;

/// Draws rest errors against telemetry; returns the text of an SVG file.
///
/// # Errors
/// If the drawing library fails.
pub fn plot_control(tradeoff: &ControlTradeoff) -> Result<String, PlotError> {
    let ages: Vec<_> = yardstick(&tradeoff.rows).collect();
    let rates: Vec<_> = tradeoff.rates.iter().collect();
    stacked(&[
        chart(
            "Rest error at 80 µm and 10 % scatter against telemetry's age (lines: bound)",
            "age of telemetry, ms",
            &ages,
            |row| row.run.age_ms,
        ),
        chart(
            "Rest error at 80 µm and 10 % scatter against telemetry's rate (lines: bound)",
            "telemetry, samples per second",
            &rates,
            |row| row.run.telemetry_hz,
        ),
    ])
}

/// A series for each frequency.
fn chart<'a>(
    title: &'a str,
    name: &'a str,
    rows: &[&ControlRow],
    x: impl Fn(&ControlRow) -> f64,
) -> Chart<'a> {
    let mut frequencies: Vec<f64> = rows.iter().map(|row| row.run.frequency_hz).collect();
    frequencies.dedup();
    let series = |hz: f64| {
        let rows = || rows.iter().filter(move |row| row.run.frequency_hz == hz);
        let points = rows().map(|row| Point { x: x(row), y: row.rest_rms_um, sd: 0.0 }).collect();
        let bounds = rows().map(|row| (x(row), row.bound_um)).collect();
        Series { points, ..Series::line(format!("{hz} Hz"), bounds) }
    };
    let series = frequencies.into_iter().map(series).collect();
    let errors = rows.iter().flat_map(|row| [row.rest_rms_um, row.bound_um]);
    Chart {
        title: Some(title),
        x: Axis { name, scale: scale(rows.iter().map(|row| x(row)), 1.0) },
        y: Axis { name: "rest error, µm RMS", scale: scale(errors, 1.2) },
        series,
    }
}

/// A range of positive numbers, `margin` times larger on either side. A single number, or none, gives no range.
fn scale(numbers: impl Iterator<Item = f64> + Clone, margin: f64) -> Scale {
    let (from, to) = (numbers.clone().fold(f64::INFINITY, f64::min), numbers.fold(0.0, f64::max));
    let (from, to) = if 0.0 < from && from < to { (from / margin, to * margin) } else { (1.0, 1000.0) };
    Scale::logarithmic(from, to)
}
