//! Time against error as SVG: a series per integrator and precision, a point per step, both axes logarithmic.
//!
//! The exact method has no error, which no logarithmic axis shows: it is a vertical line at its time. Other errors of 0
//! are drawn at a floor that the axis names: half the error of a single spike.
//!
//! Invariant: the same figures make the same bytes.

use crate::chart::PlotError;
use crate::methods::tradeoff::{MethodTradeoff, Row};
use plotters::prelude::*;

const SIZE: (u32, u32) = (960, 640);
/// The colours of the series.
const COLORS: [RGBColor; 4] =
    [RGBColor(31, 119, 180), RGBColor(255, 127, 14), RGBColor(44, 160, 44), RGBColor(214, 39, 40)];

/// Draws a comparison of methods; returns the text of an SVG file.
///
/// # Errors
/// If the drawing library fails.
pub fn plot(tradeoff: &MethodTradeoff) -> Result<String, PlotError> {
    let floor = floor_hz(tradeoff);
    let series = series(&tradeoff.rows, floor);
    let exact = tradeoff.rows.iter().find(|row| row.method.step_us.is_none()).and_then(Row::time_and_error);
    let points = || series.iter().flat_map(|(_, points)| points);
    let times = points().map(|point| point.time).chain(exact.map(|(time, _)| time));
    let errors = points().map(|point| point.error).chain([floor]);
    let (left, right) = decades(times);
    let (bottom, top) = decades(errors);

    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        area.fill(&WHITE).map_err(PlotError::new)?;
        let mut chart = ChartBuilder::on(&area)
            .margin(16)
            .x_label_area_size(44)
            .y_label_area_size(72)
            .caption("Simulation: time against error", ("sans-serif", 20))
            .build_cartesian_2d((left..right).log_scale(), (bottom..top).log_scale())
            .map_err(PlotError::new)?;
        chart
            .configure_mesh()
            .light_line_style(RGBColor(240, 240, 240))
            .x_desc("time, us per afferent and second")
            .y_desc(format!("rate error, impulses/s RMS (0 is drawn at {floor:.2e})"))
            .x_label_formatter(&|x| format!("{x}"))
            .y_label_formatter(&|y| format!("{y}"))
            .draw()
            .map_err(PlotError::new)?;
        if let Some((time, _)) = exact {
            chart
                .draw_series(LineSeries::new([(time, bottom), (time, top)], BLACK.stroke_width(2)))
                .map_err(PlotError::new)?
                .label("exact (no error)")
                .legend(|(x, y)| PathElement::new([(x, y), (x + 20, y)], BLACK.stroke_width(2)));
        }
        for ((name, points), color) in series.iter().zip(COLORS.into_iter().cycle()) {
            let line = points.iter().map(|point| (point.time, point.error));
            chart
                .draw_series(LineSeries::new(line, color.stroke_width(1)))
                .map_err(PlotError::new)?
                .label(name)
                .legend(move |(x, y)| Circle::new((x + 10, y), 4, color.filled()));
            let marks = points.iter().map(|point| {
                let text = Text::new(
                    format!("{} us", point.step_us),
                    (6, -14),
                    ("sans-serif", 11).into_font().color(&color),
                );
                EmptyElement::at((point.time, point.error)) + Circle::new((0, 0), 4, color.filled()) + text
            });
            chart.draw_series(marks).map_err(PlotError::new)?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE)
            .border_style(RGBColor(200, 200, 200))
            .draw()
            .map_err(PlotError::new)?;
        area.present().map_err(PlotError::new)?;
    }
    Ok(svg)
}

#[derive(Clone, Copy, Debug)]
struct Point {
    step_us: u32,
    time: f64,
    error: f64,
}

/// The points of each integrator and precision, in the order of the rows.
fn series(rows: &[Row], floor: f64) -> Vec<(String, Vec<Point>)> {
    let mut series: Vec<(String, Vec<Point>)> = Vec::new();
    for row in rows {
        let (Some((integrator, precision)), Some(step_us)) = (row.method.names(), row.method.step_us) else {
            continue;
        };
        let Some((time, error)) = row.time_and_error() else { continue };
        let point = Point { step_us, time, error: error.max(floor) };
        let name = format!("{integrator} {precision}");
        match series.iter_mut().find(|(known, _)| *known == name) {
            Some((_, points)) => points.push(point),
            None => series.push((name, vec![point])),
        }
    }
    series
}

/// Half of the least possible error: one spike of one afferent.
fn floor_hz(tradeoff: &MethodTradeoff) -> f64 {
    let least = 1.0 / tradeoff.duration_s / (tradeoff.afferents as f64).sqrt();
    if least.is_finite() && least > 0.0 { least / 2.0 } else { 1e-3 }
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
