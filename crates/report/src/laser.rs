//! Draws a motor's calibration with a laser as SVG: the measurement, the fit, and the residuals.
//!
//! There are three charts: the whole recording, a close-up of the longest bursts, and the residuals.
//!
//! Invariant: the same fit makes the same bytes; a chart has at most [`MOST_POINTS`] points, even of a long recording.

use crate::chart::{Axis, Chart, Dot, HEIGHT, Point, Scale, Series, stacked};
use meissner_stream::calibrate::{LaserFit, TracePoint};

/// A longer line is drawn as this many pairs of lowest and highest values.
const MOST_POINTS: usize = 2000;
/// The duration of the close-up, s: two strokes.
const NEAR_S: f64 = 0.5;

/// Draws a fit; returns the text of an SVG file.
#[must_use]
pub fn plot_laser(fit: &LaserFit) -> String {
    let all = &fit.trace;
    let measured = |point: &TracePoint| point.measured_um;
    let fitted = |point: &TracePoint| point.fitted_um;
    let residual = |point: &TracePoint| point.measured_um - point.fitted_um;
    let near = near(all);
    let title = format!("Motor {}: pin over the plan, drift of the sensor taken out", fit.motor);
    let points = near.iter().map(|point| Point { x: point.seconds, y: point.measured_um, sd: 0.0 });
    let rings = Series { points: points.collect(), dot: Dot::Ring, ..Series::line("measured", Vec::new()) };
    let model = near.iter().map(|point| (point.seconds, point.fitted_um)).collect();
    let noise = format!("Residuals: noise {:.3} µm", fit.noise_um);
    stacked(
        &[
            chart(
                &title,
                "displacement, µm",
                vec![
                    Series::line("measured", envelope(all, measured)),
                    Series::line("fitted", envelope(all, fitted)),
                ],
            ),
            chart(
                "The highest stroke from near",
                "displacement, µm",
                vec![rings, Series::line("fitted", model)],
            ),
            chart(&noise, "measured − fitted, µm", vec![Series::line("residual", envelope(all, residual))]),
        ],
        HEIGHT,
    )
}

/// The samples about the highest one.
fn near(all: &[TracePoint]) -> &[TracePoint] {
    let highest = all.iter().max_by(|one, two| one.measured_um.total_cmp(&two.measured_um));
    let from_s = highest.map_or(0.0, |highest| highest.seconds - NEAR_S / 2.0);
    let from = all.partition_point(|point| point.seconds < from_s);
    let to = all.partition_point(|point| point.seconds < from_s + NEAR_S);
    &all[from..to]
}

/// The lowest and the highest value of each segment.
fn envelope(all: &[TracePoint], of: impl Fn(&TracePoint) -> f64) -> Vec<(f64, f64)> {
    let ends = all.chunks(all.len().div_ceil(MOST_POINTS).max(1)).flat_map(|chunk| {
        let value = |of: &dyn Fn(f64, f64) -> f64, start: f64, y: &dyn Fn(&TracePoint) -> f64| {
            chunk.iter().map(y).fold(start, of)
        };
        let lowest = value(&f64::min, f64::INFINITY, &of);
        let highest = value(&f64::max, f64::NEG_INFINITY, &of);
        [(chunk[0].seconds, lowest), (chunk[0].seconds, highest)]
    });
    ends.collect()
}

fn chart<'a>(title: &'a str, name: &'a str, series: Vec<Series>) -> Chart<'a> {
    let all = || {
        let points = series.iter().flat_map(|series| series.points.iter().map(|point| (point.x, point.y)));
        points.chain(series.iter().flat_map(|series| series.line.iter().copied()))
    };
    let scale = |of: fn((f64, f64)) -> f64| {
        let low = all().map(of).fold(f64::INFINITY, f64::min);
        let high = all().map(of).fold(f64::NEG_INFINITY, f64::max);
        // An empty range, or one that is not a number, becomes that of an empty chart.
        if low < high { Scale::linear(low, high) } else { Scale::linear(0.0, 1.0) }
    };
    Chart {
        title: Some(title),
        x: Axis { name: "time since the first burst, s", scale: scale(|point| point.0) },
        y: Axis { name, scale: scale(|point| point.1) },
        series,
    }
}
