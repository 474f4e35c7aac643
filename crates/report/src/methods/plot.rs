//! Time against error as SVG: a series per integrator and precision, a point per step, both axes logarithmic.
//!
//! Errors of 0, such as the exact method's, lie in a strip below the break of the axis.
//!
//! Invariant: the same figures make the same bytes.

use crate::chart::{Axis, Chart, Scale, Series, draw};
use crate::methods::tradeoff::{MethodTradeoff, Row};

/// Draws a comparison of methods; returns the text of an SVG file.
#[must_use]
pub fn plot(tradeoff: &MethodTradeoff) -> String {
    let exact = tradeoff.rows.iter().find(|row| row.method.step_us.is_none()).and_then(Row::time_and_error);
    let exact = exact.map(|(time, _)| Series::marked("exact, without steps", vec![(time, 0.0)]));
    let series: Vec<Series> = exact.into_iter().chain(series(&tradeoff.rows)).collect();
    let points = || series.iter().flat_map(|series| &series.line);
    let (left, right) = decades(points().map(|point| point.0));
    let (bottom, top) = decades(points().map(|point| point.1));
    draw(&Chart {
        title: Some("Simulation: time against error, labelled with the step"),
        x: Axis { name: "time, µs per afferent and second", scale: Scale::logarithmic(left, right) },
        y: Axis { name: "rate error, impulses/s RMS", scale: Scale::logarithmic(bottom, top).broken("0") },
        series,
    })
}

/// The points of each integrator and precision, in the order of the rows.
fn series(rows: &[Row]) -> Vec<Series> {
    let mut found: Vec<Series> = Vec::new();
    for row in rows {
        let (Some((integrator, precision)), Some(step_us)) = (row.method.names(), row.method.step_us) else {
            continue;
        };
        let Some((time, error)) = row.time_and_error() else { continue };
        let name = format!("{integrator} {precision}");
        let one =
            Series { labels: vec![format!("{step_us} µs")], ..Series::marked(name, vec![(time, error)]) };
        match found.iter_mut().find(|series| series.name == one.name) {
            Some(series) => {
                series.line.extend(one.line);
                series.points.extend(one.points);
                series.labels.extend(one.labels);
            }
            None => found.push(one),
        }
    }
    found
}

/// The whole decades that contain these numbers.
fn decades(numbers: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = numbers
        .filter(|number| *number > 0.0)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), number| (low.min(number), high.max(number)));
    if low > high {
        return (1.0, 10.0);
    }
    let (low, high) = (low.log10().floor(), high.log10().ceil());
    (10_f64.powf(low), 10_f64.powf(high.max(low + 1.0)))
}
