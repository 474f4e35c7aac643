//! Maps: the array with the vibration of each motor, the fingertip's pad with the rate of each afferent, and a small map of both.
//!
//! All show the array from above, with the fingertip up, each pin at its place. All panels of a map share one colour scale. A pad may show the shape of a
//! target, with rings around the ON afferents. Pins are coloured by the amplitude that they reach: a fast motor may hardly move.
//!
//! Invariant: every panel shows every motor, on or off.

use crate::figures::color::{color, ink};
use crate::figures::table::number;
use crate::svg::{Anchor, Drawing, Paint};
use meissner_array::pattern::Drive;
use meissner_array::spec::ArraySpec;
use meissner_skin::membrane::{PAD_LENGTH_MM, PAD_WIDTH_MM, Position};

const INK: &str = "#222222";
const FAINT: &str = "#bbbbbb";
/// Colour of less important text: grey, but readable on white.
const FADED: &str = "#6b6b6b";
/// The colour of the target: not on the colour scale, and visible to red-green blind people.
const AIMED: &str = "#d55e00";
const NONE: &str = "none";
/// The label of the upward direction, and the title of a map that needs no other.
pub(super) const FINGERTIP: &str = "fingertip";

/// The distance of the two nearest motors, px.
const PITCH: f64 = 78.0;
/// The radius of a motor's circle, px.
const RADIUS: f64 = 35.0;
/// Sizes of text, px: titles; frequencies; other numbers.
const TITLE: u32 = 16;
const LARGE: u32 = 12;
const SMALL: u32 = 11;
/// The height of a panel's title, px.
const HEAD: f64 = 48.0;
/// The width of a drawing that the page can show without shrinking its text, px.
const PAGE: f64 = 960.0;
/// Width with its text, and height, of a colour bar, px.
const BAR: (f64, f64) = (110.0, 300.0);
/// The vibrations of the motors in a segment of time.
#[derive(Clone, Debug)]
pub(super) struct Panel<'a> {
    pub(super) title: String,
    /// At most one per motor.
    pub(super) pins: Vec<Pin<'a>>,
}

/// A driven pin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pin<'a> {
    pub(super) drive: &'a Drive,
    /// The amplitude that it reaches, µm peak to peak.
    pub(super) reached_um: f64,
}

/// The end of the colour scale, µm: a multiple of 20, so that the marks are round.
fn top_um<'a>(pins: impl Iterator<Item = &'a Pin<'a>>) -> f64 {
    (pins.fold(0.0_f64, |highest, pin| highest.max(pin.reached_um)) / 20.0).ceil().max(1.0) * 20.0
}

/// The sides of the smallest rectangle around the pins' places: left and right, bottom and top, mm.
fn sides_mm(array: &ArraySpec) -> [(f64, f64); 2] {
    [0, 1].map(|axis| {
        let places = || array.positions_mm().iter().map(|place| place[axis]);
        (places().fold(f64::INFINITY, f64::min), places().fold(f64::NEG_INFINITY, f64::max))
    })
}

/// Draws the array in each panel: a circle per motor, coloured by the amplitude reached, with its number, frequency, amplitude and
/// phase; off is hollow.
pub(super) fn motors(array: &ArraySpec, panels: &[Panel<'_>]) -> String {
    let top_um = top_um(panels.iter().flat_map(|panel| &panel.pins));
    let [(left_mm, right_mm), (bottom_mm, top_mm)] = sides_mm(array);
    let px = |mm: f64| PITCH * (mm / array.pitch_mm() + 0.5);
    let width = px(right_mm - left_mm) + PITCH / 2.0 + 24.0;
    let height = px(top_mm - bottom_mm) + PITCH / 2.0 + HEAD + 12.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few, or 0")]
    let across = (((PAGE - BAR.0) / width) as usize).min(panels.len()).max(1);
    let down = panels.len().div_ceil(across);
    let size = (width * across as f64 + BAR.0, (height * down as f64).max(BAR.1 + 80.0));
    let mut drawing = Drawing::new(size.0, size.1);
    for (index, panel) in panels.iter().enumerate() {
        let corner = (width * (index % across) as f64, height * (index / across) as f64);
        drawing.words((corner.0 + width / 2.0, corner.1 + 28.0), TITLE, Anchor::Middle, INK, &panel.title);
        for motor in array.numbers() {
            let [x_mm, y_mm] = array.position_mm(motor);
            let x = corner.0 + 12.0 + px(x_mm - left_mm);
            let y = corner.1 + HEAD + px(top_mm - y_mm);
            let Some(pin) = panel.pins.iter().find(|pin| pin.drive.motor == motor) else {
                drawing.circle((x, y), RADIUS, Paint { fill: NONE, stroke: FAINT });
                drawing.words((x, y + 4.0), SMALL, Anchor::Middle, FADED, &motor.to_string());
                continue;
            };
            let share = pin.reached_um / top_um;
            let ink = ink(share);
            drawing.circle((x, y), RADIUS, Paint { fill: &color(share), stroke: INK });
            let hz = format!("{} Hz", number(pin.drive.frequency_hz));
            let um = format!("{} µm", tenths(pin.reached_um));
            drawing.words((x, y - 16.0), SMALL, Anchor::Middle, ink, &motor.to_string());
            drawing.words((x, y - 2.0), LARGE, Anchor::Middle, ink, &hz);
            drawing.words((x, y + 12.0), LARGE, Anchor::Middle, ink, &um);
            drawing.words((x, y + 26.0), SMALL, Anchor::Middle, ink, &number(pin.drive.phase));
        }
    }
    let marks = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| (share, number(share * top_um)));
    bar(&mut drawing, (size.0 - BAR.0 + 16.0, HEAD), "µm reached", &marks);
    drawing.finish()
}

/// A number with at most one decimal.
fn tenths(of: f64) -> String {
    number((of * 10.0).round() / 10.0)
}

/// Pixels per mm of a small map.
const SMALL_PER_MM: f64 = 6.0;
/// The largest radius of a pin there, mm, and its largest share of the pitch: so pins are easy to see and do not touch.
const SMALL_PIN: (f64, f64) = (1.1, 0.45);

/// Half the width and half the height of a map of the skin, mm: the pad, and all pins.
fn half_mm(array: &ArraySpec) -> [f64; 2] {
    let reach = |(low, high): (f64, f64)| high.max(-low) + array.pin_radius_mm();
    let [across, along] = sides_mm(array).map(reach);
    [across.max(PAD_WIDTH_MM / 2.0), along.max(PAD_LENGTH_MM / 2.0)]
}

/// Draws a pattern small, for an overview: the pad, its pins coloured by the amplitude they reach, and the target's outline.
pub(super) fn small(array: &ArraySpec, pins: &[Pin<'_>], outline: &[Vec<[f64; 2]>]) -> String {
    let (top_um, margin) = (top_um(pins.iter()), 4.0);
    let size = half_mm(array).map(|mm| 2.0 * mm * SMALL_PER_MM + 2.0 * margin);
    let radius = SMALL_PIN.0.min(SMALL_PIN.1 * array.pitch_mm()) * SMALL_PER_MM;
    let middle = (size[0] / 2.0, size[1] / 2.0);
    let place = |[x_mm, y_mm]: [f64; 2]| (middle.0 + x_mm * SMALL_PER_MM, middle.1 - y_mm * SMALL_PER_MM);
    let mut drawing = Drawing::new(size[0], size[1]);
    let radii = (PAD_WIDTH_MM / 2.0 * SMALL_PER_MM, PAD_LENGTH_MM / 2.0 * SMALL_PER_MM);
    drawing.ellipse(middle, radii, Paint { fill: "#f4f4f4", stroke: FAINT });
    for motor in array.numbers() {
        let pin = pins.iter().find(|pin| pin.drive.motor == motor);
        let fill = pin.map_or_else(|| "#dddddd".to_owned(), |pin| color(pin.reached_um / top_um));
        let at = place(array.position_mm(motor));
        drawing.circle(at, radius, Paint { fill: &fill, stroke: FADED });
    }
    draw_outline(&mut drawing, outline, place, (1.5, 0.35 * SMALL_PER_MM));
    drawing.finish()
}

/// Draws a target's outline: dots of this radius, and lines of this width, px. It is cut at the pad; the ends of lines on the pad's
/// edge are rounded.
fn draw_outline(
    drawing: &mut Drawing,
    outline: &[Vec<[f64; 2]>],
    place: impl Fn([f64; 2]) -> (f64, f64),
    (width, radius): (f64, f64),
) {
    let beyond = |&[x_mm, y_mm]: &[f64; 2]| {
        x_mm.abs() > PAD_WIDTH_MM / 2.0 + 1e-6 || y_mm.abs() > PAD_LENGTH_MM / 2.0 + 1e-6
    };
    for line in outline.iter().flat_map(|line| line.split(beyond)) {
        let line: Vec<(f64, f64)> = line.iter().copied().map(&place).collect();
        match line[..] {
            [] => {}
            [at] => drawing.circle(at, radius, Paint { fill: AIMED, stroke: NONE }),
            _ => drawing.line(&line, width, AIMED),
        }
    }
}

/// Draws a colour bar, its unit above it, and marks beside it.
fn bar(drawing: &mut Drawing, (x, y): (f64, f64), unit: &str, marks: &[(f64, String)]) {
    const PIECES: u32 = 60;
    let height = BAR.1 / f64::from(PIECES);
    drawing.words((x, y - 10.0), LARGE, Anchor::Start, INK, unit);
    for piece in 0..PIECES {
        let share = (f64::from(piece) + 0.5) / f64::from(PIECES);
        let top = y + BAR.1 - height * f64::from(piece + 1);
        // A little taller than a step, so that no seams show.
        drawing.rectangle((x, top), (18.0, height + 0.5), Paint { fill: &color(share), stroke: NONE });
    }
    for (share, mark) in marks {
        drawing.words((x + 24.0, y + BAR.1 * (1.0 - share) + 4.0), SMALL, Anchor::Start, INK, mark);
    }
}

/// Pixels per mm of skin, for up to two pads and for more.
const PER_MM: (f64, f64) = (20.0, 12.0);
/// The margin around a pad, px.
const MARGIN: f64 = 30.0;
/// The drawn share of a pin's radius: so pins that stand side by side do not touch.
const PIN_SHARE: f64 = 0.9;
/// Radii of an afferent and the ring around it, mm.
const SIZES_MM: [f64; 2] = [0.225, 0.34];

/// A fingertip's pad with the pins and its afferents.
#[derive(Clone, Debug)]
pub(super) struct Pad<'a> {
    pub(super) title: String,
    pub(super) afferents: &'a [Position],
    /// The rate of each afferent, impulses/s; without rates all are grey.
    pub(super) rates_hz: Option<&'a [f64]>,
    /// The target.
    pub(super) aim: Option<Aim<'a>>,
}

/// A target on a pad.
#[derive(Clone, Debug)]
pub(super) struct Aim<'a> {
    /// Polylines, mm; a single point is a dot.
    pub(super) outline: Vec<Vec<[f64; 2]>>,
    /// Whether each afferent is ON.
    pub(super) on: &'a [bool],
}

/// Draws pads beside each other, with a colour bar if any has rates.
pub(super) fn pads(array: &ArraySpec, pads: &[Pad<'_>]) -> String {
    let per_mm = if pads.len() > 2 { PER_MM.1 } else { PER_MM.0 };
    let [width, height] = half_mm(array).map(|mm| 2.0 * mm * per_mm);
    let rates = || pads.iter().filter_map(|pad| pad.rates_hz).flatten();
    let highest = rates().fold(0.0_f64, |highest, &rate| highest.max(rate));
    // A multiple of 50, or of 10, so that the marks are round.
    let step = if highest > 50.0 { 50.0 } else { 10.0 };
    let top_hz = (highest / step).ceil().max(1.0) * step;
    let bar_width = if rates().next().is_some() { BAR.0 + 6.0 } else { 0.0 };
    let step = width + MARGIN;
    let (all, tall) = (MARGIN + step * pads.len() as f64 + bar_width, height + HEAD + MARGIN);
    let mut drawing = Drawing::new(all, if bar_width > 0.0 { tall.max(BAR.1 + HEAD + 60.0) } else { tall });
    for (index, pad) in pads.iter().enumerate() {
        let middle = (MARGIN + step * index as f64 + width / 2.0, HEAD + height / 2.0);
        pad.draw(array, &mut drawing, middle, per_mm, top_hz);
    }
    if bar_width > 0.0 {
        let marks = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0].map(|share| (share, number(share * top_hz)));
        bar(&mut drawing, (all - BAR.0, HEAD + 40.0), "impulses/s", &marks);
    }
    drawing.finish()
}

impl Pad<'_> {
    fn draw(&self, array: &ArraySpec, drawing: &mut Drawing, middle: (f64, f64), per_mm: f64, top_hz: f64) {
        let place = |[x_mm, y_mm]: [f64; 2]| (middle.0 + x_mm * per_mm, middle.1 - y_mm * per_mm);
        let pin = PIN_SHARE * array.pin_radius_mm() * per_mm;
        let [dot, ring] = SIZES_MM.map(|mm| mm * per_mm);
        drawing.words((middle.0, 28.0), TITLE, Anchor::Middle, INK, &self.title);
        let [rx, ry] = [PAD_WIDTH_MM, PAD_LENGTH_MM].map(|mm| mm / 2.0 * per_mm);
        drawing.ellipse(middle, (rx, ry), Paint { fill: "#f4f4f4", stroke: INK });
        for at in array.positions_mm() {
            drawing.circle(place(*at), pin, Paint { fill: NONE, stroke: FAINT });
        }
        for (index, at) in self.afferents.iter().enumerate() {
            let fill =
                self.rates_hz.map_or_else(|| "#777777".to_owned(), |rates| color(rates[index] / top_hz));
            let at = place([at.x_mm, at.y_mm]);
            drawing.circle(at, dot, Paint { fill: &fill, stroke: NONE });
            if self.aim.as_ref().is_some_and(|aim| aim.on[index]) {
                drawing.circle(at, ring, Paint { fill: NONE, stroke: AIMED });
            }
        }
        if let Some(aim) = &self.aim {
            draw_outline(drawing, &aim.outline, place, (2.5, ring));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec::{self, Array};

    #[test]
    fn every_motor_is_on_the_map() {
        let (frequency_hz, amplitude_um, phase) = (60.0, 80.0, 0.25);
        let drive = Drive { motor: 9, frequency_hz, amplitude_um, phase, start_s: None, stop_s: None };
        let panel = |title: &str, reached_um| Panel {
            title: title.to_owned(),
            pins: vec![Pin { drive: &drive, reached_um }],
        };
        let array = Array::paper();
        let svg = motors(&array, &[panel("before", 69.14), panel("<after>", 0.0)]);
        assert_eq!((svg.matches("<ellipse").count(), svg.matches(">60 Hz<").count()), (48, 2));
        assert_eq!(svg.matches(r#"fill="none""#).count(), 46);
        assert!(svg.contains(">69.1 µm<") && svg.contains(">0 µm<"));
        assert!(svg.contains(&format!(r#"fill="{}""#, color(69.14 / 80.0))));
        assert!(svg.contains(">0.25<") && svg.contains(">before<") && svg.contains(">&lt;after&gt;<"));
        let svg = small(&array, &panel("", 80.0).pins, &[vec![[0.0, 0.0], [1.0, 0.0]], vec![[99.0, 0.0]]]);
        assert_eq!((svg.matches("<ellipse").count(), svg.matches("<polyline").count()), (25, 1));
        assert_eq!(svg.matches(&*color(1.0)).count(), 1);
    }

    /// The centres and fills of the ellipses of a drawing.
    fn ellipses(svg: &str) -> Vec<(f64, f64, &str)> {
        let elements = svg.lines().filter(|line| line.starts_with("<ellipse"));
        // The values of cx, cy, rx, ry and fill are the odd pieces between quotation marks.
        let values = elements.map(|line| line.split('"').skip(1).step_by(2).collect::<Vec<_>>());
        values.map(|of| (of[0].parse().unwrap(), of[1].parse().unwrap(), of[4])).collect()
    }

    #[test]
    fn pads_show_every_afferent_on_one_scale_and_the_target() {
        let afferents = [0.0, 1.0, -2.0].map(|y_mm| Position { x_mm: 0.0, y_mm });
        let pad = |rates_hz, aim| Pad { title: "t".to_owned(), afferents: &afferents, rates_hz, aim };
        let array = Array::paper();
        let svg = pads(&array, &[pad(Some(&[0.0, 10.0, 120.0]), None), pad(Some(&[0.0, 60.0, 0.0]), None)]);
        let found = ellipses(&svg);
        assert_eq!(found.len(), 2 * (1 + 24 + 3));
        assert!(svg.contains(">150<"));
        // Up is towards the fingertip.
        let [_, high, low] = found[25..28] else { panic!() };
        assert!(high.1 < low.1 && high.0 == low.0);
        assert_eq!((low.2, found[28 + 26].2), (&*color(0.8), &*color(0.4)));

        let outline = vec![vec![[0.0, 0.0]], vec![[-1.0, 0.0], [1.0, 0.0], [99.0, 0.0], [2.0, 0.0]]];
        let svg = pads(&array, &[pad(None, Some(Aim { outline, on: &[true, false, true] }))]);
        assert_eq!(ellipses(&svg).len(), 1 + 24 + 3 + 2 + 2, "two are ringed, two are dots");
        assert_eq!((svg.matches("<polyline").count(), svg.matches("impulses/s").count()), (1, 0));
    }

    #[test]
    fn every_pin_of_every_array_is_drawn_apart_from_the_others() {
        // Pins without rows and columns, and a pin beyond the pad.
        let places = "[[-12.0, 0.0], [0.0, 13.5], [0.25, -3.0], [2.5, -3.0]]";
        let odd = format!(
            "name = \"map-test\"\npins = {{ positions_mm = {places} }}\ntick_hz = 70000\nduty = {{ up = 0.25, down = 0.75 }}\n\
             rails = [[0, 1, 2, 3]]\nchips = [[0, 1], [2, 3]]\n[motor]\nstep_um = 0.2\nwindow_ms = 3.0\ntravel_um = 300.0\n\
             most_pulses = 2000"
        );
        let odd = ArraySpec::parse(&odd, "map-test.toml").unwrap();
        let shipped = spec::names().into_iter().map(|name| Array::named(name).unwrap().spec());
        for array in shipped.chain([&odd]) {
            let name = array.name();
            let panel = Panel { title: "t".to_owned(), pins: Vec::new() };
            let pad = Pad { title: "t".to_owned(), afferents: &[], rates_hz: None, aim: None };
            for (svg, besides) in
                [(motors(array, &[panel]), 0), (small(array, &[], &[]), 1), (pads(array, &[pad]), 1)]
            {
                let pins = &ellipses(&svg)[besides..];
                assert_eq!(pins.len(), array.motors(), "{name}");
                let side = |name: &str| -> f64 {
                    svg.split_once(&format!("{name}=\""))
                        .unwrap()
                        .1
                        .split('"')
                        .next()
                        .unwrap()
                        .parse()
                        .unwrap()
                };
                let radius: f64 =
                    svg.rsplit_once("rx=\"").unwrap().1.split('"').next().unwrap().parse().unwrap();
                for (number, &(x, y, _)) in pins.iter().enumerate() {
                    let within = |at: f64, side: f64| at >= radius - 0.01 && at + radius <= side + 0.51;
                    assert!(
                        within(x, side("width")) && within(y, side("height")),
                        "{name} {number}: {x} {y}"
                    );
                    let apart = |&(other_x, other_y, _): &(f64, f64, &str)| (x - other_x).hypot(y - other_y);
                    let nearest = pins[..number].iter().map(apart).fold(f64::INFINITY, f64::min);
                    assert!(nearest > 2.0 * radius, "{name} {number}: {nearest} {radius}");
                    // Up is towards the fingertip, the right side is the right side.
                    let [x_mm, y_mm] = array.position_mm(number as u8);
                    let [first_x_mm, first_y_mm] = array.position_mm(0);
                    let (right, down) = (x - pins[0].0, y - pins[0].1);
                    assert!((x_mm - first_x_mm) * right >= 0.0 && (y_mm - first_y_mm) * down <= 0.0);
                }
            }
        }
    }
}
