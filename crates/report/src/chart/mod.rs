//! Charts as SVG: lines and measured points on two axes.
//!
//! A series is a line, points, or both. Colour, dash and marker tell series apart, so that a chart can be read in grey. The legend
//! lies beside the axes and covers nothing. `scale` computes the axes, `labels` places the labels of points.
//!
//! Invariant: the same numbers make the same bytes.

mod labels;
mod scale;

pub use scale::{Axis, Scale};

use crate::svg::{Anchor, Drawing, Paint};
use labels::Place;
use scale::{BREAK, STRIP};
use std::ops::Range;

/// The width of a chart, and the height of one that stands alone, px.
const WIDTH: i32 = 960;
pub(crate) const HEIGHT: u16 = 560;
/// Sizes of text, px: titles, names of axes, marks and the legend, labels of points.
const TITLE: u32 = 16;
const NAME: u32 = 13;
const MARK: u32 = 12;
const LABEL: u32 = 11;
/// Free space around everything, px.
const MARGIN: i32 = 16;
/// Spaces above the axes for a title, left of them and below them, px.
const ABOVE: i32 = 28;
const LEFT: i32 = 64;
const BELOW: i32 = 44;
/// From the middle of a line of text down to its base line, px.
const BASE: i32 = 4;
/// The legend: width of a line's sample and of a character, and the distance of rows, px.
const SAMPLE: i32 = 34;
const CHARACTER: f64 = 6.6;
const ROW: i32 = 20;
/// The most marks of an axis, and their least distance, px.
const MARKS: usize = 11;
const APART: usize = 30;
const INK: &str = "#000000";
const PAPER: &str = "#ffffff";
const GRID: &str = "#e4e4e4";
/// How series are drawn, in order: colours that red-green blind people can tell apart (Okabe and Ito), dash and gap of the line, px,
/// and the corners of the marker about its point, px. The first is a solid line with discs.
const LOOKS: [Look; 6] = [
    Look { color: INK, dash: "", marker: &[] },
    Look { color: "#0072b2", dash: "8 4", marker: &[(-3, -3), (3, -3), (3, 3), (-3, 3)] },
    Look { color: "#d55e00", dash: "3 3", marker: &[(0, -5), (4, 3), (-4, 3)] },
    Look { color: "#009e73", dash: "14 5", marker: &[(0, -5), (4, 0), (0, 5), (-4, 0)] },
    Look { color: "#cc79a7", dash: "6 8", marker: &[(0, 5), (4, -3), (-4, -3)] },
    Look { color: "#e69f00", dash: "2 6", marker: &[(-5, -2), (0, -5), (5, -2), (3, 4), (-3, 4)] },
];

/// A chart.
#[derive(Clone, Debug)]
pub struct Chart<'a> {
    /// None where a caption serves as the title.
    pub title: Option<&'a str>,
    /// The axis from left to right.
    pub x: Axis<'a>,
    /// The axis upwards.
    pub y: Axis<'a>,
    /// What is drawn; the later over the earlier.
    pub series: Vec<Series>,
}

/// A line and its points.
#[derive(Clone, Debug)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// The corners of the line; none without a line.
    pub line: Vec<(f64, f64)>,
    /// The points.
    pub points: Vec<Point>,
    /// How each point is drawn.
    pub dot: Dot,
    /// Empty, or a label for each point. A label that would cover another one is left out.
    pub labels: Vec<String>,
}

/// How a point is drawn.
#[derive(Clone, Copy, Debug)]
pub enum Dot {
    /// Filled, in the series' shape, with its error bar.
    Filled,
    /// Open, so that many can be told apart; without an error bar.
    Ring,
    /// Open, without an error bar.
    Square,
}

/// A measured point.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// Its place on the x axis.
    pub x: f64,
    /// Its place on the y axis.
    pub y: f64,
    /// Half the length of the error bar.
    pub sd: f64,
}

impl Series {
    /// A line without points.
    #[must_use]
    pub fn line(name: impl Into<String>, line: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), line, points: Vec::new(), dot: Dot::Filled, labels: Vec::new() }
    }

    /// A line with a marker at each point.
    pub(crate) fn marked(name: impl Into<String>, line: Vec<(f64, f64)>) -> Self {
        let points = line.iter().map(|&(x, y)| Point { x, y, sd: 0.0 }).collect();
        Self { points, ..Self::line(name, line) }
    }
}

/// A place in the drawing, px.
type Pixel = (i32, i32);

fn float((x, y): Pixel) -> (f64, f64) {
    (x.into(), y.into())
}

/// Draws a chart; returns the text of an SVG file.
pub(crate) fn draw(chart: &Chart<'_>) -> String {
    stacked(std::slice::from_ref(chart), HEIGHT)
}

/// Draws charts of this height, px, one above the other; returns the text of an SVG file.
#[must_use]
pub fn stacked(charts: &[Chart<'_>], height: u16) -> String {
    let height = i32::from(height);
    let mut drawing = Drawing::new(WIDTH.into(), f64::from(height) * charts.len() as f64);
    // One column of legends, so that axes of stacked charts line up.
    let names = charts.iter().flat_map(|chart| &chart.series).map(|series| series.name.chars().count());
    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
    let legend = SAMPLE + MARGIN + (names.max().unwrap_or(0) as f64 * CHARACTER).ceil() as i32;
    for (chart, row) in charts.iter().zip(0..) {
        let top = row * height;
        let above = if chart.title.is_some() { ABOVE } else { 0 };
        let x = MARGIN + LEFT..WIDTH - legend;
        chart.draw(&mut drawing, x, top + MARGIN + above..top + height - MARGIN - BELOW);
    }
    drawing.finish()
}

impl Chart<'_> {
    /// Draws the chart with its axes in this range of pixels.
    fn draw(&self, drawing: &mut Drawing, x: Range<i32>, y: Range<i32>) {
        self.draw_axes(drawing, &x, &y);
        let pixel = |at: (f64, f64)| {
            (self.x.scale.pixel(at.0, x.start, x.end), self.y.scale.pixel(at.1, y.end, y.start))
        };
        let looks = || LOOKS.iter().cycle();
        for (look, series) in looks().zip(&self.series) {
            // No line crosses the break.
            let strip = |y: f64| self.y.scale.is_below(y);
            for part in series.line.chunk_by(|a, b| strip(a.1) == strip(b.1)) {
                look.draw_line(drawing, &part.iter().map(|&at| float(pixel(at))).collect::<Vec<_>>());
            }
            for &Point { x, y, sd } in series.points.iter().filter(|point| point.sd > 0.0) {
                drawing.line(&[pixel((x, y - sd)), pixel((x, y + sd))].map(float), 1.0, look.color);
            }
        }
        // Draw markers last, so that no line covers one.
        let place = |point: &Point| pixel((point.x, point.y));
        let placed: Vec<Vec<Pixel>> =
            self.series.iter().map(|series| series.points.iter().map(place).collect()).collect();
        for ((look, series), places) in looks().zip(&self.series).zip(&placed) {
            for &at in places {
                look.draw_marker(drawing, at, series.dot);
            }
        }
        let labelled = (self.series.iter().zip(&placed).zip(looks())).flat_map(|((series, places), look)| {
            places.iter().zip(&series.labels).map(move |(&at, text)| ((at, text.as_str()), look.color))
        });
        let (texts, colors): (Vec<_>, Vec<_>) = labelled.unzip();
        let lines: Vec<Vec<Pixel>> = (self.series.iter())
            .filter(|_| !texts.is_empty())
            .map(|series| series.line.iter().map(|&at| pixel(at)).collect())
            .collect();
        let found = labels::place(&texts, &placed.concat(), &lines, [x.start, y.start, x.end, y.end]);
        for ((at, (_, text)), color) in found.into_iter().zip(texts).zip(colors) {
            let Some([left, _, _, bottom]): Option<Place> = at else { continue };
            drawing.words(float((left, bottom - 2)), LABEL, Anchor::Start, color, text);
        }
        for (row, (look, series)) in (0..).zip(looks().zip(&self.series)) {
            let (x, y) = (x.end + MARGIN / 2, y.start + MARGIN / 2 + ROW * row);
            if !series.line.is_empty() {
                look.draw_line(drawing, &[(x, y), (x + SAMPLE - 8, y)].map(float));
            }
            if !series.points.is_empty() {
                look.draw_marker(drawing, (x + SAMPLE / 2 - 4, y), series.dot);
            }
            drawing.words(float((x + SAMPLE, y + BASE)), MARK, Anchor::Start, INK, &series.name);
        }
    }

    /// Draws the title, and the axes with their names, marks and grid.
    fn draw_axes(&self, drawing: &mut Drawing, x: &Range<i32>, y: &Range<i32>) {
        let most = |range: &Range<i32>| (range.len() / APART).clamp(1, MARKS);
        let middle = (i32::midpoint(x.start, x.end), i32::midpoint(y.start, y.end));
        if let Some(title) = self.title {
            drawing.words(float((WIDTH / 2, y.start - MARGIN / 2)), TITLE, Anchor::Middle, INK, title);
        }
        for mark in self.x.scale.marks(most(x)) {
            let at = self.x.scale.pixel(mark, x.start, x.end);
            drawing.line(&[(at, y.start), (at, y.end)].map(float), 1.0, GRID);
            drawing.words(float((at, y.end + 18)), MARK, Anchor::Middle, INK, &scale::text(mark));
        }
        for mark in self.y.scale.marks(most(y)) {
            let at = self.y.scale.pixel(mark, y.end, y.start);
            drawing.line(&[(x.start, at), (x.end, at)].map(float), 1.0, GRID);
            drawing.words(float((x.start - 8, at + BASE)), MARK, Anchor::End, INK, &scale::text(mark));
        }
        drawing.line(&[(x.start, y.start), (x.start, y.end), (x.end, y.end)].map(float), 1.0, INK);
        drawing.words(float((middle.0, y.end + BELOW - BASE)), NAME, Anchor::Middle, INK, self.x.name);
        drawing.turned(float((MARGIN + NAME as i32, middle.1)), NAME, Anchor::Middle, INK, self.y.name);
        if let Some(below) = self.y.scale.below {
            draw_break(drawing, x.start, y, below);
        }
    }
}

/// Breaks the y axis at `x`: two strokes across it, and the label of the strip below.
fn draw_break(drawing: &mut Drawing, x: i32, y: &Range<i32>, below: &str) {
    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
    let at = |share: f64| y.end - (share * f64::from(y.end - y.start)).round() as i32;
    let middle = at(BREAK);
    drawing.rectangle(float((x - 4, middle - 3)), (8.0, 6.0), Paint { fill: PAPER, stroke: "none" });
    for offset in [-3, 3] {
        let stroke = [(x - 6, middle + offset + 3), (x + 6, middle + offset - 3)];
        drawing.line(&stroke.map(float), 1.0, INK);
    }
    drawing.words(float((x - 8, at(STRIP) + BASE)), MARK, Anchor::End, INK, below);
}

/// How a series is drawn.
struct Look {
    color: &'static str,
    dash: &'static str,
    marker: &'static [Pixel],
}

impl Look {
    fn draw_line(&self, drawing: &mut Drawing, points: &[(f64, f64)]) {
        if self.dash.is_empty() {
            drawing.line(points, 2.0, self.color);
        } else {
            drawing.dashed(points, 2.0, self.color, self.dash);
        }
    }

    fn draw_marker(&self, drawing: &mut Drawing, at: Pixel, dot: Dot) {
        let (open, filled) =
            (Paint { fill: "none", stroke: self.color }, Paint { fill: self.color, stroke: "none" });
        match (dot, self.marker) {
            (Dot::Ring, _) => drawing.circle(float(at), 3.0, open),
            (Dot::Square, _) => drawing.rectangle(float((at.0 - 3, at.1 - 3)), (6.0, 6.0), open),
            (Dot::Filled, []) => drawing.circle(float(at), 4.0, filled),
            (Dot::Filled, marker) => {
                let corners: Vec<_> = marker.iter().map(|(x, y)| float((at.0 + x, at.1 + y))).collect();
                drawing.polygon(&corners, self.color);
            }
        }
    }
}
