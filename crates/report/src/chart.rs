//! Charts as SVG: lines and measured points on two axes.
//!
//! A series is a line, points, or both, in one colour. Axes are linear or logarithmic, with marks in steps of 1, 2 and
//! 5. A value outside an axis is drawn at its edge.
//!
//! Invariant: the same numbers make the same bytes.

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;
use std::fmt::Display;
use std::ops::Range;

const SIZE: (u32, u32) = (960, 560);
/// Colours that red-green blind people can tell apart (Okabe and Ito).
const COLORS: [RGBColor; 6] = [
    RGBColor(0, 0, 0),
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
];

/// A chart that could not be drawn: a bug of ours.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("internal error: the plot cannot be drawn: {message}")]
pub struct PlotError {
    /// The error of the drawing library.
    pub message: String,
}

impl PlotError {
    pub(crate) fn new(error: impl Display) -> Self {
        Self { message: error.to_string() }
    }
}

/// A chart.
pub(crate) struct Chart<'a> {
    pub(crate) title: &'a str,
    pub(crate) x: Axis<'a>,
    pub(crate) y: Axis<'a>,
    /// The position of the legend.
    pub(crate) legend: SeriesLabelPosition,
    pub(crate) series: Vec<Series>,
}

/// An axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis<'a> {
    /// The quantity and its unit.
    pub(crate) name: &'a str,
    pub(crate) scale: Scale,
}

/// The range of an axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale {
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// A logarithmic range is above 0.
    pub(crate) logarithmic: bool,
}

/// A line and its points.
pub(crate) struct Series {
    pub(crate) name: String,
    pub(crate) line: Vec<(f64, f64)>,
    pub(crate) points: Vec<Point>,
    pub(crate) dot: Dot,
}

/// How a point is drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Dot {
    /// Filled, with its error bar.
    Disc,
    /// Open, so that many can be told apart; without an error bar.
    Ring,
    /// Open, without an error bar.
    Square,
}

/// A measured point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Half the length of the error bar.
    pub(crate) sd: f64,
}

impl Series {
    /// A line without points.
    pub(crate) fn line(name: impl Into<String>, line: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), line, points: Vec::new(), dot: Dot::Disc }
    }

    /// A line with a disc at each point.
    pub(crate) fn marked(name: impl Into<String>, line: Vec<(f64, f64)>) -> Self {
        let points = line.iter().map(|&(x, y)| Point { x, y, sd: 0.0 }).collect();
        Self { points, ..Self::line(name, line) }
    }
}

impl Scale {
    pub(crate) const fn linear(from: f64, to: f64) -> Self {
        Self { from, to, logarithmic: false }
    }

    pub(crate) const fn logarithmic(from: f64, to: f64) -> Self {
        Self { from, to, logarithmic: true }
    }

    /// A linear range between multiples of 50 that contains these values.
    pub(crate) fn fifties(lowest: f64, highest: f64) -> Self {
        Self::linear((lowest / 50.0).floor() * 50.0, (highest / 50.0).ceil().max(1.0) * 50.0)
    }

    /// The share of the axis before a value, 0 to 1.
    fn share(&self, value: f64) -> f64 {
        let value = value.clamp(self.from, self.to);
        if self.logarithmic {
            (value / self.from).ln() / (self.to / self.from).ln()
        } else {
            (value - self.from) / (self.to - self.from)
        }
    }

    /// The marks: 1, 2 and 5 of each decade, or at most `most` multiples of such a step.
    fn marks(&self, most: usize) -> Vec<f64> {
        const STEPS: [f64; 3] = [1.0, 2.0, 5.0];
        let steps = || (-9..=9).flat_map(|decade| STEPS.map(|step| format!("{step}e{decade}")));
        let steps: Vec<f64> = steps().filter_map(|step| step.parse().ok()).collect();
        if self.logarithmic {
            return steps.into_iter().filter(|mark| (self.from..=self.to).contains(mark)).collect();
        }
        let span = self.to - self.from;
        let step = steps.into_iter().find(|step| span / step <= most as f64).unwrap_or(span);
        let first = (self.from / step).ceil();
        let marks = (0..=most).map(|count| (first + count as f64) * step);
        marks.take_while(|mark| *mark <= self.to + step * 1e-9).collect()
    }
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        limit.0 + (self.share(*value) * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        self.marks(hint.max_num_points().min(20))
    }

    fn range(&self) -> Range<f64> {
        self.from..self.to
    }
}

impl ValueFormatter<f64> for Scale {
    fn format(value: &f64) -> String {
        // Multiples of a step may differ from round numbers in their last bits.
        format!("{}", (value * 1e9).round() / 1e9)
    }
}

/// Draws a chart; returns the text of an SVG file.
pub(crate) fn draw(chart: &Chart<'_>) -> Result<String, PlotError> {
    stacked(std::slice::from_ref(chart))
}

/// Draws charts, one above the other; returns the text of an SVG file.
pub(crate) fn stacked(charts: &[Chart<'_>]) -> Result<String, PlotError> {
    let mut svg = String::new();
    let height = SIZE.1 * charts.len() as u32;
    let whole = SVGBackend::with_string(&mut svg, (SIZE.0, height)).into_drawing_area();
    whole.fill(&WHITE).map_err(PlotError::new)?;
    for (chart, area) in charts.iter().zip(whole.split_evenly((charts.len(), 1))) {
        let mut context = ChartBuilder::on(&area)
            .margin(16)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .caption(chart.title, ("sans-serif", 20))
            .build_cartesian_2d(chart.x.scale, chart.y.scale)
            .map_err(PlotError::new)?;
        context
            .configure_mesh()
            .max_light_lines(0)
            .bold_line_style(RGBColor(228, 228, 228))
            .x_desc(chart.x.name)
            .y_desc(chart.y.name)
            .draw()
            .map_err(PlotError::new)?;
        for (series, color) in chart.series.iter().zip(COLORS.into_iter().cycle()) {
            let line = LineSeries::new(series.line.iter().copied(), color.stroke_width(2));
            let label = context.draw_series(line).map_err(PlotError::new)?.label(&series.name);
            let at = series.points.iter().map(|point| (point.x, point.y));
            match series.dot {
                Dot::Disc => {
                    label
                        .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color.stroke_width(2)));
                    let bars = series.points.iter().map(|&Point { x, y, sd }| {
                        PathElement::new([(x, y - sd), (x, y + sd)], color.stroke_width(1))
                    });
                    context.draw_series(bars).map_err(PlotError::new)?;
                    let dots = at.map(|at| Circle::new(at, 3, color.filled()));
                    context.draw_series(dots).map_err(PlotError::new)?;
                }
                Dot::Ring => {
                    label.legend(move |(x, y)| Circle::new((x + 10, y), 3, color.stroke_width(1)));
                    let rings = at.map(|at| Circle::new(at, 3, color.stroke_width(1)));
                    context.draw_series(rings).map_err(PlotError::new)?;
                }
                Dot::Square => {
                    let corners = [(-3, -3), (3, 3)];
                    label.legend(move |(x, y)| {
                        let corners = corners.map(|(dx, dy)| (x + 10 + dx, y + dy));
                        Rectangle::new(corners, color.stroke_width(1))
                    });
                    let squares =
                        at.map(|at| EmptyElement::at(at) + Rectangle::new(corners, color.stroke_width(1)));
                    context.draw_series(squares).map_err(PlotError::new)?;
                }
            }
        }
        context
            .configure_series_labels()
            .position(chart.legend.clone())
            .background_style(WHITE)
            .border_style(RGBColor(200, 200, 200))
            .draw()
            .map_err(PlotError::new)?;
    }
    whole.present().map_err(PlotError::new)?;
    drop(whole);
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_ones_twos_and_fives() {
        let logarithmic = Scale::logarithmic(1.0, 300.0);
        assert_eq!(logarithmic.marks(20), [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0]);
        assert_eq!(
            (logarithmic.share(1.0), logarithmic.share(300.0), logarithmic.share(0.0)),
            (0.0, 1.0, 0.0)
        );
        let linear = Scale::linear(0.0, 300.0);
        assert_eq!(linear.marks(10), [0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0]);
        assert_eq!((linear.share(75.0), linear.map(&150.0, (10, 110))), (0.25, 60));
        assert_eq!(Scale::format(&(0.1 + 0.2)), "0.3");
    }
}
