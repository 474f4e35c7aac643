//! The rest error against telemetry's age and against its rate as an SVG, one above the other: the bound as a line, what
//! was measured as discs. Where there is no room, bursts are shorter than planned and scatter less than the bound takes them to.
//!
//! Invariant: the same figures make the same bytes.

use super::summary::yardstick;
use super::{ControlRow, ControlTradeoff};
use crate::PlotError;
use crate::figures::chart::{Axis, Chart, Dot, Point, Scale, Series, stacked};
use plotters::prelude::SeriesLabelPosition;

/// Draws a trade-off of the loop; the text of an SVG file.
///
/// # Errors
/// If the drawing library gives up.
pub fn plot_control(tradeoff: &ControlTradeoff) -> Result<String, PlotError> {
    let ages: Vec<_> = yardstick(&tradeoff.rows).collect();
    let rates: Vec<_> = tradeoff.rates.iter().collect();
    stacked(&[
        chart(
            "Rest error at 80 um and 10 % scatter against telemetry's age (lines: bound)",
            "age of telemetry, ms",
            &ages,
            |row| row.age_ms,
            SeriesLabelPosition::UpperLeft,
        ),
        chart(
            "Rest error at 80 um and 10 % scatter against telemetry's rate (lines: bound)",
            "telemetry, samples per second",
            &rates,
            |row| row.telemetry_hz,
            SeriesLabelPosition::UpperRight,
        ),
    ])
}

/// A series for each frequency.
fn chart<'a>(
    title: &'a str,
    name: &'a str,
    rows: &[&ControlRow],
    x: impl Fn(&ControlRow) -> f64,
    legend: SeriesLabelPosition,
) -> Chart<'a> {
    let mut frequencies: Vec<f64> = rows.iter().map(|row| row.frequency_hz).collect();
    frequencies.dedup();
    let series = |hz: f64| {
        let rows = || rows.iter().filter(move |row| row.frequency_hz == hz);
        Series {
            name: format!("{hz} Hz"),
            line: rows().map(|row| (x(row), row.bound_um)).collect(),
            points: rows().map(|row| Point { x: x(row), y: row.rest_rms_um, sd: 0.0 }).collect(),
            dot: Dot::Disc,
        }
    };
    let series = frequencies.into_iter().map(series).collect();
    let errors = rows.iter().flat_map(|row| [row.rest_rms_um, row.bound_um]);
    Chart {
        title,
        x: Axis { name, scale: scale(rows.iter().map(|row| x(row)), 1.0) },
        y: Axis { name: "rest error, um RMS", scale: scale(errors, 1.2) },
        legend,
        series,
    }
}

/// What holds these numbers, which are above 0, and so much more on either side. One, or none, has no width.
fn scale(numbers: impl Iterator<Item = f64> + Clone, margin: f64) -> Scale {
    let (from, to) = (numbers.clone().fold(f64::INFINITY, f64::min), numbers.fold(0.0, f64::max));
    let (from, to) = if 0.0 < from && from < to { (from / margin, to * margin) } else { (1.0, 1000.0) };
    Scale { from, to, logarithmic: true }
}
