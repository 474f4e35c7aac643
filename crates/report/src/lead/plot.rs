//! Late bursts, onsets and bytes against the lead as SVG: three charts, one above the other.
//!
//! Invariant: the same figures make the same bytes.

use crate::chart::{Axis, Chart, PlotError, Scale, Series, stacked};
use crate::lead::tradeoff::{LeadRow, LeadTradeoff};

/// The name of a series, and its value for a row.
type Curve<'a> = (&'a str, &'a dyn Fn(&LeadRow) -> Option<f64>);

/// Draws a comparison of leads; returns the text of an SVG file.
///
/// # Errors
/// If the drawing library fails.
pub fn plot_lead(tradeoff: &LeadTradeoff) -> Result<String, PlotError> {
    let late = format!("Late bursts, under {} s of recorded stalls", tradeoff.trace.seconds);
    stacked(&[
        chart(tradeoff, &late, "late, percent", &[("late bursts", &|row| Some(100.0 * row.late_share))]),
        chart(
            tradeoff,
            "From a request to its onset",
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

/// A chart of one quantity, from 0 up.
fn chart<'a>(tradeoff: &LeadTradeoff, title: &'a str, name: &'a str, curves: &[Curve<'_>]) -> Chart<'a> {
    let series = |&(name, figure): &Curve<'_>| {
        let points = tradeoff.rows.iter().filter_map(|row| Some((row.lead_ms, figure(row)?)));
        Series::marked(name, points.collect())
    };
    let series: Vec<_> = curves.iter().map(series).collect();
    let most = series.iter().flat_map(|series| &series.line).map(|point| point.1).fold(0.0, f64::max);
    let leads = || tradeoff.rows.iter().map(|row| row.lead_ms);
    let (from, to) = (leads().fold(f64::INFINITY, f64::min), leads().fold(0.0, f64::max));
    // A single lead, or none, gives no range.
    let (from, to) = if from < to { (from, to) } else { (1.0, 1000.0) };
    Chart {
        title: Some(title),
        x: Axis { name: "lead, ms", scale: Scale::logarithmic(from, to) },
        y: Axis { name, scale: Scale::linear(0.0, if most > 0.0 { most * 1.1 } else { 1.0 }) },
        series,
    }
}
