//! Maps: the array with what each motor does, and the pad with what each receptor sends.
//!
//! Both are seen as one looks down on the array, fingertip up. An array has a panel per stretch of a pattern. A [`Pad`]
//! can be drawn upon before it is finished.
//!
//! Invariant: every motor has its place in every panel, whether it moves or not.

use super::color::{color, ink};
use super::stretches::Stretch;
use super::svg::{Anchor, Drawing, Paint};
use super::table::number;
use crate::array::{self, COLUMNS, ROWS};
use crate::skin::{PAD_LENGTH_MM, PAD_WIDTH_MM, Position};
use firmware_protocol::stroke::MOTORS;

const INK: &str = "#222222";
const FAINT: &str = "#bbbbbb";
const NONE: &str = "none";

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

/// The array during each stretch: a circle per motor, coloured by frequency, with frequency and phase; off is hollow.
pub(super) fn motors(stretches: &[Stretch]) -> String {
    let (width, height) = (PITCH * f64::from(COLUMNS) + 24.0, PITCH * f64::from(ROWS) + HEAD + 12.0);
    let across = stretches.len().clamp(1, ACROSS);
    let down = stretches.len().div_ceil(across);
    let size = (width * across as f64 + BAR.0, (height * down as f64).max(BAR.1 + 80.0));
    let mut drawing = Drawing::new(size.0, size.1);
    for (index, stretch) in stretches.iter().enumerate() {
        let corner = (width * (index % across) as f64, height * (index / across) as f64);
        let title = match (stretches.len(), stretch.stop_s) {
            (1, _) => "fingertip".to_owned(),
            (_, Some(stop_s)) => format!("{} to {} s", number(stretch.start_s), number(stop_s)),
            (_, None) => format!("from {} s on", number(stretch.start_s)),
        };
        drawing.words((corner.0 + width / 2.0, corner.1 + 28.0), 15, Anchor::Middle, INK, &title);
        for motor in 0..MOTORS as u8 {
            let x = corner.0 + 12.0 + PITCH * (f64::from(array::column(motor)) + 0.5);
            let y = corner.1 + HEAD + PITCH * (f64::from(array::row(motor)) + 0.5);
            let Some(drive) = stretch.drives.iter().find(|drive| drive.motor == motor) else {
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

/// Pixels per mm of skin.
const PER_MM: f64 = 20.0;
/// Around the pad, px.
const MARGIN: f64 = 30.0;

/// The finger's pad, its pins, and receptors on it.
#[derive(Debug)]
pub(super) struct Pad {
    drawing: Drawing,
}

impl Pad {
    /// The ellipse and the 24 pins.
    pub(super) fn new() -> Self {
        let (width, height) = (PAD_WIDTH_MM * PER_MM, PAD_LENGTH_MM * PER_MM);
        let mut drawing = Drawing::new(width + 2.0 * MARGIN + BAR.0, height + HEAD + MARGIN);
        let middle = Self::place(Position { x_mm: 0.0, y_mm: 0.0 });
        drawing.words((middle.0, 28.0), 15, Anchor::Middle, INK, "fingertip");
        drawing.ellipse(middle, (width / 2.0, height / 2.0), Paint { fill: "#f4f4f4", stroke: INK });
        for motor in 0..MOTORS as u8 {
            let [x_mm, y_mm] = array::position_mm(motor);
            drawing.circle(Self::place(Position { x_mm, y_mm }), 9.0, Paint { fill: NONE, stroke: FAINT });
        }
        Self { drawing }
    }

    /// Where a place on the skin is drawn, px.
    pub(super) fn place(at: Position) -> (f64, f64) {
        let x = MARGIN + (PAD_WIDTH_MM / 2.0 + at.x_mm) * PER_MM;
        let y = HEAD + (PAD_LENGTH_MM / 2.0 - at.y_mm) * PER_MM;
        (x, y)
    }

    /// Receptors as dots coloured by rate, and the colour bar. Rates are impulses/s.
    pub(super) fn rates(&mut self, receptors: &[Position], rates_hz: &[f64]) {
        let highest = rates_hz.iter().fold(0.0_f64, |highest, &rate| highest.max(rate));
        // Whole fifties, so that the marks are round.
        let top = (highest / 50.0).ceil().max(1.0) * 50.0;
        for (&at, rate) in receptors.iter().zip(rates_hz) {
            let fill = color(rate / top);
            self.drawing.circle(Self::place(at), 4.5, Paint { fill: &fill, stroke: NONE });
        }
        let marks = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0].map(|part| (part, number(part * top)));
        let x = PAD_WIDTH_MM * PER_MM + 2.0 * MARGIN + 6.0;
        bar(&mut self.drawing, (x, HEAD + 40.0), "impulses/s", &marks);
    }

    /// The text of an SVG file.
    pub(super) fn finish(self) -> String {
        self.drawing.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Drive;

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
        let stretch = Stretch { start_s: 0.0, stop_s: Some(1.0), drives: vec![drive] };
        let svg = motors(&[stretch.clone(), stretch]);
        assert_eq!((svg.matches("<ellipse").count(), svg.matches(">60 Hz<").count()), (48, 2));
        assert_eq!(svg.matches(r#"fill="none""#).count(), 46);
        assert!(svg.contains(">0.25<") && svg.contains(">0 to 1 s<"));
        let (low, high) = (Position { x_mm: 0.0, y_mm: -1.0 }, Position { x_mm: 0.0, y_mm: 1.0 });
        assert!(Pad::place(high).1 < Pad::place(low).1);
        assert_eq!((place(5.0), place(300.0)), (0.0, 1.0));
    }

    #[test]
    fn a_pad_shows_every_receptor() {
        let mut pad = Pad::new();
        pad.rates(&[Position { x_mm: 0.0, y_mm: 0.0 }; 3], &[0.0, 10.0, 120.0]);
        let svg = pad.finish();
        assert_eq!(svg.matches("<ellipse").count(), 1 + 24 + 3);
        assert!(svg.contains(">150<") && svg.contains(&color(0.8)));
    }
}
