//! Charts as SVG: lines and measured points on two axes.
//!
//! A series is a line, points, or both. Colour, dash and marker tell series apart, so that a chart can be read in grey. The legend
//! lies beside the axes and covers nothing. `scale` computes the axes, `labels` places the labels of points.
//!
//! Invariant: the same numbers make the same bytes.

mod labels;
mod scale;

pub(crate) use scale::{Axis, Scale};

use labels::Place;
use plotters::coord::Shift;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use scale::{BREAK, STRIP};
use std::fmt::Display;

/// The size of a chart, px.
const SIZE: (u32, u32) = (960, 560);
/// Sizes of text: titles, names of axes, marks and the legend, labels of points. The drawing library writes them divided by 1.24:
/// 16, 13, 12 and 11 px.
const TITLE: u32 = 20;
const NAME: u32 = 16;
const MARK: u32 = 15;
const LABEL: u32 = 14;
const FONT: &str = "sans-serif";
/// Free space around everything, px.
const MARGIN: i32 = 16;
/// Spaces left of and below the axes, px.
const LEFT: u32 = 64;
const BELOW: u32 = 44;
/// The legend: width of a line's sample and of a character, and the distance of rows, px.
const SAMPLE: i32 = 34;
const CHARACTER: f64 = 6.6;
const ROW: i32 = 20;
/// Colours that red-green blind people can tell apart (Okabe and Ito).
const COLORS: [RGBColor; 6] = [
    RGBColor(0, 0, 0),
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
];
/// Dash and gap of each series, px; the first has a solid line.
const DASHES: [Option<(i32, i32)>; 6] =
    [None, Some((8, 4)), Some((3, 3)), Some((14, 5)), Some((6, 8)), Some((2, 6))];
/// A line with more points is drawn solid, because the drawing library makes an element of every dash.
const MOST_DASHED: usize = 500;
/// The corners of each series' marker about its point, px; the first is a disc.
const MARKERS: [&[(i32, i32)]; 6] = [
    &[],
    &[(-3, -3), (3, -3), (3, 3), (-3, 3)],
    &[(0, -5), (4, 3), (-4, 3)],
    &[(0, -5), (4, 0), (0, 5), (-4, 0)],
    &[(0, 5), (4, -3), (-4, -3)],
    &[(-5, -2), (0, -5), (5, -2), (3, 4), (-3, 4)],
];

/// A chart could not be drawn: our bug.
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
    /// None where a caption serves as the title.
    pub(crate) title: Option<&'a str>,
    pub(crate) x: Axis<'a>,
    pub(crate) y: Axis<'a>,
    pub(crate) series: Vec<Series>,
}

/// A line and its points.
#[derive(Clone, Debug)]
pub(crate) struct Series {
    pub(crate) name: String,
    pub(crate) line: Vec<(f64, f64)>,
    pub(crate) points: Vec<Point>,
    pub(crate) dot: Dot,
    /// Empty, or a label for each point. A label that would cover another one is left out.
    pub(crate) labels: Vec<String>,
}

/// How a point is drawn.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Dot {
    /// Filled, in the series' shape, with its error bar.
    Filled,
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
        Self { name: name.into(), line, points: Vec::new(), dot: Dot::Filled, labels: Vec::new() }
    }

    /// A line with a marker at each point.
    pub(crate) fn marked(name: impl Into<String>, line: Vec<(f64, f64)>) -> Self {
        let points = line.iter().map(|&(x, y)| Point { x, y, sd: 0.0 }).collect();
        Self { points, ..Self::line(name, line) }
    }
}

/// Draws a chart; returns the text of an SVG file.
pub(crate) fn draw(chart: &Chart<'_>) -> Result<String, PlotError> {
    stacked(std::slice::from_ref(chart))
}

/// Draws charts, one above the other; returns the text of an SVG file.
pub(crate) fn stacked(charts: &[Chart<'_>]) -> Result<String, PlotError> {
    let mut svg = String::new();
    let whole = SVGBackend::with_string(&mut svg, (SIZE.0, SIZE.1 * charts.len() as u32)).into_drawing_area();
    whole.fill(&WHITE).map_err(PlotError::new)?;
    // One column of legends, so that axes of stacked charts line up.
    let names = charts.iter().flat_map(|chart| &chart.series).map(|series| series.name.chars().count());
    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
    let legend = SAMPLE + MARGIN + (names.max().unwrap_or(0) as f64 * CHARACTER).ceil() as i32;
    for (chart, area) in charts.iter().zip(whole.split_evenly((charts.len(), 1))) {
        axes_and_series(chart, &area, &whole, legend).map_err(PlotError::new)?;
    }
    whole.present().map_err(PlotError::new)?;
    drop(whole);
    Ok(svg)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// Draws a chart in its area. `whole` is the drawing, in whose pixels labels and legends are placed.
fn axes_and_series<'a>(chart: &Chart<'_>, area: &Area<'a>, whole: &Area<'a>, legend: i32) -> Drawn {
    let mut builder = ChartBuilder::on(area);
    builder.margin(MARGIN).margin_right(legend).x_label_area_size(BELOW).y_label_area_size(LEFT);
    if let Some(title) = chart.title {
        builder.caption(title, (FONT, TITLE));
    }
    let mut context = builder.build_cartesian_2d(chart.x.scale, chart.y.scale)?;
    context
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(RGBColor(228, 228, 228))
        .axis_desc_style((FONT, NAME))
        .label_style((FONT, MARK))
        .x_desc(chart.x.name)
        .y_desc(chart.y.name)
        .draw()?;
    let (x, y) = context.plotting_area().get_pixel_range();
    if let Some(below) = chart.y.scale.below {
        draw_break(whole, x.start, y.start..y.end, below)?;
    }
    let pixel = |x: f64, y: f64| context.backend_coord(&(x, y));
    for (look, series) in looks().zip(&chart.series) {
        // No line crosses the break.
        let strip = |y: f64| chart.y.scale.is_below(y);
        for part in series.line.chunk_by(|a, b| strip(a.1) == strip(b.1)) {
            look.draw_line(whole, part.iter().map(|&(x, y)| pixel(x, y)).collect())?;
        }
        for &Point { x, y, sd } in series.points.iter().filter(|point| point.sd > 0.0) {
            whole
                .draw(&PathElement::new([pixel(x, y - sd), pixel(x, y + sd)], look.color.stroke_width(1)))?;
        }
    }
    // Draw markers last, so that no line covers one.
    let place = |point: &Point| pixel(point.x, point.y);
    let placed: Vec<Vec<(i32, i32)>> =
        chart.series.iter().map(|series| series.points.iter().map(place).collect()).collect();
    for ((look, series), places) in looks().zip(&chart.series).zip(&placed) {
        for &at in places {
            look.draw_marker(whole, at, series.dot)?;
        }
    }
    let labelled: Vec<_> = (chart.series.iter().zip(&placed).zip(looks()))
        .flat_map(|((series, places), look)| {
            places.iter().zip(&series.labels).map(move |(&at, text)| ((at, text.as_str()), look.color))
        })
        .collect();
    let (texts, colors): (Vec<_>, Vec<_>) = labelled.into_iter().unzip();
    let lines: Vec<Vec<(i32, i32)>> = (chart.series.iter())
        .filter(|_| !texts.is_empty())
        .map(|series| series.line.iter().map(|&(x, y)| pixel(x, y)).collect())
        .collect();
    let found = labels::place(&texts, &placed.concat(), &lines, [x.start, y.start, x.end, y.end]);
    for ((at, (_, text)), color) in found.into_iter().zip(texts).zip(colors) {
        let Some([left, top, ..]): Option<Place> = at else { continue };
        whole.draw(&Text::new(text.to_owned(), (left, top + 1), (FONT, LABEL).into_font().color(&color)))?;
    }
    for (row, (look, series)) in (0..).zip(looks().zip(&chart.series)) {
        let (x, y) = (x.end + MARGIN / 2, y.start + MARGIN / 2 + ROW * row);
        if !series.line.is_empty() {
            look.draw_line(whole, vec![(x, y), (x + SAMPLE - 8, y)])?;
        }
        if !series.points.is_empty() {
            look.draw_marker(whole, (x + SAMPLE / 2 - 4, y), series.dot)?;
        }
        let style = (FONT, MARK).into_text_style(whole).pos(Pos::new(HPos::Left, VPos::Center));
        whole.draw(&Text::new(series.name.clone(), (x + SAMPLE, y), style))?;
    }
    Ok(())
}

/// Breaks the y axis at `x`: two strokes across it, and the label of the strip below.
fn draw_break(whole: &Area<'_>, x: i32, y: std::ops::Range<i32>, below: &str) -> Drawn {
    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
    let at = |share: f64| y.end - (share * f64::from(y.end - y.start)).round() as i32;
    let middle = at(BREAK);
    whole.draw(&Rectangle::new([(x - 4, middle - 3), (x + 4, middle + 3)], WHITE.filled()))?;
    for offset in [-3, 3] {
        let stroke = [(x - 6, middle + offset + 3), (x + 6, middle + offset - 3)];
        whole.draw(&PathElement::new(stroke, BLACK.stroke_width(1)))?;
    }
    let style = (FONT, MARK).into_text_style(whole).pos(Pos::new(HPos::Right, VPos::Center));
    whole.draw(&Text::new(below.to_owned(), (x - 8, at(STRIP)), style))
}

/// How a series is drawn.
#[derive(Clone, Copy)]
struct Look {
    color: RGBColor,
    dash: Option<(i32, i32)>,
    marker: &'static [(i32, i32)],
}

/// The looks of series, in order.
fn looks() -> impl Iterator<Item = Look> {
    let looks = COLORS.into_iter().zip(DASHES).zip(MARKERS);
    looks.map(|((color, dash), marker)| Look { color, dash, marker }).cycle()
}

impl Look {
    fn draw_line(&self, whole: &Area<'_>, pixels: Vec<(i32, i32)>) -> Drawn {
        let style = self.color.stroke_width(2);
        match self.dash.filter(|_| pixels.len() <= MOST_DASHED) {
            Some((size, gap)) => whole.draw(&DashedPathElement::new(pixels, size, gap, style)),
            None => whole.draw(&PathElement::new(pixels, style)),
        }
    }

    fn draw_marker(&self, whole: &Area<'_>, at: (i32, i32), dot: Dot) -> Drawn {
        let corners = |of: &[(i32, i32)]| of.iter().map(|(x, y)| (at.0 + x, at.1 + y)).collect::<Vec<_>>();
        match (dot, self.marker) {
            (Dot::Ring, _) => whole.draw(&Circle::new(at, 3, self.color.stroke_width(1))),
            (Dot::Square, _) => whole.draw(&Rectangle::new(
                [(at.0 - 3, at.1 - 3), (at.0 + 3, at.1 + 3)],
                self.color.stroke_width(1),
            )),
            (Dot::Filled, []) => whole.draw(&Circle::new(at, 4, self.color.filled())),
            (Dot::Filled, marker) => whole.draw(&Polygon::new(corners(marker), self.color.filled())),
        }
    }
}
