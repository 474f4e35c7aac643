//! Maps: the array with what each motor does, and the pad with what each receptor sends.
//!
//! Both are seen as one looks down on the array, fingertip up. Panels stand beside each other under titles of their own, all
//! on one colour scale: what looks alike is alike. On a pad the shape to be felt may be drawn, and the receptors that
//! should feel it ringed.
//!
//! Invariant: every motor has its place in every panel, whether it moves or not.

use super::color::{color, ink};
use super::svg::{Anchor, Drawing, Paint};
use super::table::number;
use firmware_protocol::stroke::MOTORS;
use meissner_array::geometry::{self, COLUMNS, ROWS};
use meissner_array::pattern::Drive;
use meissner_skin::afferent::{PAD_LENGTH_MM, PAD_WIDTH_MM, Position};

const INK: &str = "#222222";
const FAINT: &str = "#bbbbbb";
/// Of the shape to be felt and of what belongs to it: not on the colour scale, and seen by who sees no red or green.
const AIMED: &str = "#d55e00";
const NONE: &str = "none";
/// Which way is up, above a map that needs no other title.
pub(super) const FINGERTIP: &str = "fingertip";

/// Between neighbouring motors, px.
const PITCH: f64 = 72.0;
/// Of a motor's circle, px.
const RADIUS: f64 = 31.0;
/// Above a panel, for its title, px.
const HEAD: f64 = 48.0;
/// Panels beside each other.
const ACROSS: usize = 4;
/// A colour bar and its words, px.
const BAR: (f64, f64) = (110.0, 300.0);
/// Frequencies at the ends of the colour scale, Hz; it is logarithmic.
const COLORED_HZ: (f64, f64) = (5.0, 300.0);

/// A frequency's place on the colour scale.
fn place(frequency_hz: f64) -> f64 {
    let (low, high) = COLORED_HZ;
    (frequency_hz / low).ln() / (high / low).ln()
}

/// What the motors do at a time, or in a segment of it.
#[derive(Clone, Debug)]
pub(super) struct Panel<'a> {
    pub(super) title: String,
    /// One of a motor at the most.
    pub(super) drives: &'a [Drive],
}

/// The array in each panel: a circle per motor, coloured by frequency, with frequency and phase; off is hollow.
pub(super) fn motors(panels: &[Panel<'_>]) -> String {
    let (width, height) = (PITCH * f64::from(COLUMNS) + 24.0, PITCH * f64::from(ROWS) + HEAD + 12.0);
    let across = panels.len().clamp(1, ACROSS);
    let down = panels.len().div_ceil(across);
    let size = (width * across as f64 + BAR.0, (height * down as f64).max(BAR.1 + 80.0));
    let mut drawing = Drawing::new(size.0, size.1);
    for (index, panel) in panels.iter().enumerate() {
        let corner = (width * (index % across) as f64, height * (index / across) as f64);
        drawing.words((corner.0 + width / 2.0, corner.1 + 28.0), 15, Anchor::Middle, INK, &panel.title);
        for motor in 0..MOTORS as u8 {
            let x = corner.0 + 12.0 + PITCH * (f64::from(geometry::column(motor)) + 0.5);
            let y = corner.1 + HEAD + PITCH * (f64::from(geometry::row(motor)) + 0.5);
            let Some(drive) = panel.drives.iter().find(|drive| drive.motor == motor) else {
                drawing.circle((x, y), RADIUS, Paint { fill: NONE, stroke: FAINT });
                drawing.words((x, y + 4.0), 11, Anchor::Middle, FAINT, &motor.to_string());
                continue;
            };
            let part = place(drive.frequency_hz);
            let ink = ink(part);
            drawing.circle((x, y), RADIUS, Paint { fill: &color(part), stroke: INK });
            drawing.words((x, y - 12.0), 9, Anchor::Middle, ink, &motor.to_string());
            let hz = format!("{} Hz", number(drive.frequency_hz));
            drawing.words((x, y + 3.0), 12, Anchor::Middle, ink, &hz);
            drawing.words((x, y + 18.0), 11, Anchor::Middle, ink, &number(drive.phase));
        }
    }
    let marks = [5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 300.0].map(|hz: f64| (place(hz), number(hz)));
    bar(&mut drawing, (size.0 - BAR.0 + 16.0, HEAD), "Hz", &marks);
    drawing.finish()
}

/// A colour bar with its unit above it and marks beside it.
fn bar(drawing: &mut Drawing, (x, y): (f64, f64), unit: &str, marks: &[(f64, String)]) {
    const PIECES: u32 = 60;
    let height = BAR.1 / f64::from(PIECES);
    drawing.words((x, y - 10.0), 12, Anchor::Start, INK, unit);
    for piece in 0..PIECES {
        let part = (f64::from(piece) + 0.5) / f64::from(PIECES);
        let top = y + BAR.1 - height * f64::from(piece + 1);
        // A little taller, so that no seams show.
        drawing.rectangle((x, top), (18.0, height + 0.5), Paint { fill: &color(part), stroke: NONE });
    }
    for (part, mark) in marks {
        drawing.words((x + 24.0, y + BAR.1 * (1.0 - part) + 4.0), 11, Anchor::Start, INK, mark);
    }
}

/// Pixels per mm of skin: of one pad or two, and of more, which are then no wider together.
const PER_MM: (f64, f64) = (20.0, 12.0);
/// Around a pad, px.
const MARGIN: f64 = 30.0;
/// A pin, a receptor and the ring around one, mm in radius.
const SIZES_MM: [f64; 3] = [0.45, 0.225, 0.34];

/// A finger's pad with its pins, and receptors on it.
#[derive(Clone, Debug)]
pub(super) struct Pad<'a> {
    pub(super) title: String,
    pub(super) receptors: &'a [Position],
    /// Of each, impulses/s; without, they are all grey.
    pub(super) rates_hz: Option<&'a [f64]>,
    /// What is to be felt there.
    pub(super) aim: Option<Aim<'a>>,
}

/// What is to be felt.
#[derive(Clone, Debug)]
pub(super) struct Aim<'a> {
    /// Lines from point to point, mm; of one point it is a dot.
    pub(super) outline: Vec<Vec<[f64; 2]>>,
    /// Of each receptor, whether it should feel it.
    pub(super) on: &'a [bool],
}

/// Pads beside each other, with one colour bar if any has rates.
pub(super) fn pads(pads: &[Pad<'_>]) -> String {
    let per_mm = if pads.len() > 2 { PER_MM.1 } else { PER_MM.0 };
    let (width, height) = (PAD_WIDTH_MM * per_mm, PAD_LENGTH_MM * per_mm);
    let rates = || pads.iter().filter_map(|pad| pad.rates_hz).flatten();
    let highest = rates().fold(0.0_f64, |highest, &rate| highest.max(rate));
    // Whole fifties, so that the marks are round.
    let top_hz = (highest / 50.0).ceil().max(1.0) * 50.0;
    let bar_width = if rates().next().is_some() { BAR.0 + 6.0 } else { 0.0 };
    let step = width + MARGIN;
    let (all, tall) = (MARGIN + step * pads.len() as f64 + bar_width, height + HEAD + MARGIN);
    let mut drawing = Drawing::new(all, if bar_width > 0.0 { tall.max(BAR.1 + HEAD + 60.0) } else { tall });
    for (index, pad) in pads.iter().enumerate() {
        let middle = (MARGIN + step * index as f64 + width / 2.0, HEAD + height / 2.0);
        pad.draw(&mut drawing, middle, per_mm, top_hz);
    }
    if bar_width > 0.0 {
        let marks = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0].map(|part| (part, number(part * top_hz)));
        bar(&mut drawing, (all - BAR.0, HEAD + 40.0), "impulses/s", &marks);
    }
    drawing.finish()
}

impl Pad<'_> {
    fn draw(&self, drawing: &mut Drawing, middle: (f64, f64), per_mm: f64, top_hz: f64) {
        let place = |[x_mm, y_mm]: [f64; 2]| (middle.0 + x_mm * per_mm, middle.1 - y_mm * per_mm);
        let half_mm @ [half_width, half_length] = [PAD_WIDTH_MM / 2.0, PAD_LENGTH_MM / 2.0];
        let [pin, dot, ring] = SIZES_MM.map(|mm| mm * per_mm);
        drawing.words((middle.0, 28.0), 15, Anchor::Middle, INK, &self.title);
        let [rx, ry] = half_mm.map(|mm| mm * per_mm);
        drawing.ellipse(middle, (rx, ry), Paint { fill: "#f4f4f4", stroke: INK });
        for motor in 0..MOTORS as u8 {
            drawing.circle(place(geometry::position_mm(motor)), pin, Paint { fill: NONE, stroke: FAINT });
        }
        for (index, at) in self.receptors.iter().enumerate() {
            let fill =
                self.rates_hz.map_or_else(|| "#777777".to_owned(), |rates| color(rates[index] / top_hz));
            let at = place([at.x_mm, at.y_mm]);
            drawing.circle(at, dot, Paint { fill: &fill, stroke: NONE });
            if self.aim.as_ref().is_some_and(|aim| aim.on[index]) {
                drawing.circle(at, ring, Paint { fill: NONE, stroke: AIMED });
            }
        }
        // A disc may reach beyond the pad, but not into the next one. A line's end on the pad's edge is rounded.
        let beyond =
            |&[x_mm, y_mm]: &[f64; 2]| x_mm.abs() > half_width + 1e-6 || y_mm.abs() > half_length + 1e-6;
        let outline = self.aim.iter().flat_map(|aim| &aim.outline);
        for line in outline.flat_map(|line| line.split(beyond)) {
            let line: Vec<(f64, f64)> = line.iter().copied().map(place).collect();
            match line[..] {
                [] => {}
                [at] => drawing.circle(at, ring, Paint { fill: AIMED, stroke: NONE }),
                _ => drawing.line(&line, 2.5, AIMED),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::pattern::Drive;

    #[test]
    fn every_motor_is_on_the_map_and_up_is_towards_the_fingertip() {
        let drive = Drive {
            motor: 9,
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            phase: 0.25,
            start_s: None,
            stop_s: None,
        };
        let drives = [drive];
        let panel = |title: &str| Panel { title: title.to_owned(), drives: &drives };
        let svg = motors(&[panel("before"), panel("<after>")]);
        assert_eq!((svg.matches("<ellipse").count(), svg.matches(">60 Hz<").count()), (48, 2));
        assert_eq!(svg.matches(r#"fill="none""#).count(), 46);
        assert!(svg.contains(">0.25<") && svg.contains(">before<") && svg.contains(">&lt;after&gt;<"));
        assert_eq!((place(5.0), place(300.0)), (0.0, 1.0));
    }

    /// Where the ellipses of a drawing are, and what they are filled with.
    fn ellipses(svg: &str) -> Vec<(f64, f64, &str)> {
        let of = |element: &'_ str, key: &str| element.find(key).map(|at| at + key.len()).unwrap();
        let word =
            |element: &'_ str, key: &str| element[of(element, key)..].find('"').unwrap() + of(element, key);
        svg.lines()
            .filter(|line| line.starts_with("<ellipse"))
            .map(|line| {
                let value = |key: &str| &line[of(line, key)..word(line, key)];
                (value("cx=\"").parse().unwrap(), value("cy=\"").parse().unwrap(), value("fill=\""))
            })
            .collect()
    }

    #[test]
    fn pads_show_every_receptor_on_one_scale_with_what_is_to_be_felt() {
        let receptors = [0.0, 1.0, -2.0].map(|y_mm| Position { x_mm: 0.0, y_mm });
        let pad = |rates_hz, aim| Pad { title: "t".to_owned(), receptors: &receptors, rates_hz, aim };
        let svg = pads(&[pad(Some(&[0.0, 10.0, 120.0]), None), pad(Some(&[0.0, 60.0, 0.0]), None)]);
        let found = ellipses(&svg);
        assert_eq!(found.len(), 2 * (1 + 24 + 3));
        assert!(svg.contains(">150<"));
        // Up is towards the fingertip.
        let [_, high, low] = found[25..28] else { panic!() };
        assert!(high.1 < low.1 && high.0 == low.0);
        assert_eq!((low.2, found[28 + 26].2), (&*color(0.8), &*color(0.4)));

        let outline = vec![vec![[0.0, 0.0]], vec![[-1.0, 0.0], [1.0, 0.0], [99.0, 0.0], [2.0, 0.0]]];
        let svg = pads(&[pad(None, Some(Aim { outline, on: &[true, false, true] }))]);
        assert_eq!(ellipses(&svg).len(), 1 + 24 + 3 + 2 + 2, "two are ringed, two are dots");
        assert_eq!((svg.matches("<polyline").count(), svg.matches("impulses/s").count()), (1, 0));
    }
}
