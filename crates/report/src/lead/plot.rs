//! The lead against late bursts, onsets and bytes as an SVG: three charts, one above the other, over the same leads.
//!
//! Invariant: the same figures make the same bytes.

use super::{LeadRow, LeadTradeoff};
use crate::PlotError;
use crate::figures::chart::{Axis, Chart, Dot, Point, Scale, Series, stacked};
use plotters::prelude::SeriesLabelPosition;

/// A series: its name, and its figure of a row.
type Curve<'a> = (&'a str, &'a dyn Fn(&LeadRow) -> Option<f64>);

/// Draws a trade-off of leads; the text of an SVG file.
///
/// # Errors
/// If the drawing library gives up.
pub fn plot_lead(tradeoff: &LeadTradeoff) -> Result<String, PlotError> {
    let late = format!("Late bursts, under {} s of recorded stalls", tradeoff.trace.seconds);
    stacked(&[
        chart(tradeoff, &late, "late, percent", &[("late bursts", &|row| Some(100.0 * row.late_share))]),
        chart(
            tradeoff,
            "From an order to its onset",
            "onset latency, ms",
            &[
                ("longest", &|row| row.onset_ms_max),
                ("99th percentile", &|row| row.onset_ms_p99),
                ("median", &|row| row.onset_ms_p50),
            ],
        ),
        chart(
            tradeoff,
            "Load of the line",
            "bytes per burst",
            &[
                ("loop on", &|row| Some(row.bytes_per_burst_loop)),
                ("open loop", &|row| Some(row.bytes_per_burst_open)),
            ],
        ),
    ])
}

/// One quantity, from 0 up.
fn chart<'a>(tradeoff: &LeadTradeoff, title: &'a str, name: &'a str, curves: &[Curve<'_>]) -> Chart<'a> {
    let series = |&(name, figure): &Curve<'_>| {
        let points = tradeoff.rows.iter().filter_map(|row| Some((row.lead_ms, figure(row)?)));
        let line: Vec<_> = points.collect();
        let points = line.iter().map(|&(x, y)| Point { x, y, sd: 0.0 }).collect();
        Series { name: name.to_owned(), line, points, dot: Dot::Disc }
    };
    let series: Vec<_> = curves.iter().map(series).collect();
    let most = series.iter().flat_map(|series| &series.line).map(|point| point.1).fold(0.0, f64::max);
    let leads = || tradeoff.rows.iter().map(|row| row.lead_ms);
    let (from, to) = (leads().fold(f64::INFINITY, f64::min), leads().fold(0.0, f64::max));
    // One lead, or none, has no width.
    let (from, to) = if from < to { (from, to) } else { (1.0, 1000.0) };
    Chart {
        title,
        x: Axis { name: "lead, ms", scale: Scale { from, to, logarithmic: true } },
        y: Axis {
            name,
            scale: Scale { from: 0.0, to: if most > 0.0 { most * 1.1 } else { 1.0 }, logarithmic: false },
        },
        legend: SeriesLabelPosition::UpperRight,
        series,
    }
}
