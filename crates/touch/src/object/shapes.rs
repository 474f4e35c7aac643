//! The shapes of object files. A shape is one row of [`SHAPES`], and one struct of its keys.
//!
//! A new shape needs both here, and a row in `docs/reference/object.md`. [`Keys`] says what it has to give; whatever else names shapes
//! (the reader, its errors, the keys of other shapes) takes them from the rows.
//!
//! Invariant: a surface is in the object's frame; the reader places it.

use super::error::{KeyError, MAX_POINTS, MAX_SIDE_MM, Problem};
use super::source::{Numbers, Open, Source, bytes_of, check_places, missing};
use super::surface::{HeightMap, Surface};
use super::{DOT_MM, LINE_MM, image};
use crate::braille::dots as braille_dots;
use crate::shape::{Shape, level_direction};
use crate::touch::MAX_PLACE_MM;
use meissner_array::samples::{Column, read_profile};
use meissner_array::spec::Array;
use meissner_input::document::{self, CommonProblem, given, in_range, keys_of};
use meissner_input::message::quote;
use meissner_skin::membrane::PAD_LENGTH_MM;
use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer};
use std::sync::LazyLock;

/// All shapes, by the name in the file. A search takes those that are drawn.
pub(super) const SHAPES: &[Row] = &[
    row::<Bar>("bar").drawn(),
    row::<Edge>("edge"),
    row::<Line<2>>("segment").drawn(),
    row::<Line<MAX_POINTS>>("polyline").drawn(),
    row::<Disc>("disc").drawn(),
    row::<Dots>("dots").drawn(),
    row::<Gap>("gap"),
    row::<Grating>("grating").drawn(),
    row::<Braille>("braille").drawn(),
    // A search takes one line.
    row::<Lines>("lines"),
    row::<Polygon>("polygon"),
    row::<Heightmap>("heightmap"),
    row::<Texture>("texture"),
];

pub(super) struct Row {
    pub(super) name: &'static str,
    pub(super) is_drawn: bool,
    pub(super) keys: fn() -> &'static [&'static str],
    pub(super) read: fn(&Source<'_>) -> Result<Box<dyn Keys>, KeyError>,
}

/// The keys of a shape.
pub(super) trait Keys {
    /// Checks the keys, and makes the surface.
    fn surface(&self, open: Open<'_>) -> Result<Surface, KeyError>;

    /// Where a search wants afferents to fire, on the skin, once the surface is made; none if it cannot take the shape.
    fn drawn(&self, surface: Surface, center_mm: [f64; 2], angle_deg: f64) -> Option<Shape> {
        let shape = match surface {
            Surface::Near { shape, .. } => shape,
            Surface::Lines { lines, .. } if lines.len() == 1 => Shape::Polyline(lines.concat()),
            _ => return None,
        };
        Some(shape.moved(center_mm, angle_deg))
    }

    /// The key that places its points.
    fn placed_by(&self) -> &'static str {
        "center_mm"
    }
}

const fn row<K: Keys + DeserializeOwned + 'static>(name: &'static str) -> Row {
    let read = |source: &Source<'_>| -> Result<Box<dyn Keys>, KeyError> {
        // A missing key has no line.
        let no_line = |fault: KeyError| match fault.problem {
            document::Problem::Common(CommonProblem::Missing { .. }) => KeyError { line: None, ..fault },
            _ => fault,
        };
        Ok(Box::new(source.read::<K>(wanted).map_err(no_line)?))
    };
    Row { name, is_drawn: false, keys: keys_of::<K>, read }
}

impl Row {
    const fn drawn(self) -> Self {
        Self { is_drawn: true, ..self }
    }

    pub(super) fn has(&self, key: &str) -> bool {
        (self.keys)().contains(&key)
    }
}

/// The names of some shapes, as in "bar, edge or dots".
pub(super) fn names(of: impl Fn(&Row) -> bool, quoted: &str) -> String {
    let names: Vec<_> =
        SHAPES.iter().filter(|row| of(row)).map(|row| format!("{quoted}{}{quoted}", row.name)).collect();
    match names.split_last() {
        Some((last, others)) if !others.is_empty() => format!("{} or {last}", others.join(", ")),
        _ => names.concat(),
    }
}

/// What to add where a key of a shape is missing.
fn wanted(key: &str) -> &'static str {
    match key {
        "points" => "points = [[x, y], ...], in mm",
        "lines" => "lines = [[[x, y], [x, y], ...], ...], in mm",
        "text" => "text = \"...\", letters or six-dot Braille characters",
        "file" => "file = \"...\", the file's name",
        _ => "a length, mm",
    }
}

/// What to add where the shape is missing.
pub(super) static WANTED: LazyLock<String> = LazyLock::new(|| format!("shape = {}", names(|_| true, "\"")));

/// Reads the name of a shape.
pub(super) fn named<'de, D: Deserializer<'de>>(source: D) -> Result<&'static Row, D::Error> {
    static NAMES: LazyLock<Vec<&str>> = LazyLock::new(|| SHAPES.iter().map(|row| row.name).collect());
    let name = String::deserialize(source)?;
    let row = SHAPES.iter().find(|row| row.name == name);
    row.ok_or_else(|| D::Error::unknown_variant(&name, &NAMES))
}

/// A length within its range.
fn length(key: &str, found: f64, least: f64, most: f64) -> Result<f64, KeyError> {
    in_range(key, found, (least..=most).contains(&found), format!("{least} to {most} mm"))?;
    Ok(found)
}

/// The width of something.
fn wide(key: &str, found: f64) -> Result<f64, KeyError> {
    length(key, found, 0.1, 100.0)
}

type Points = Vec<Numbers<2>>;

fn places(
    points: &Points,
    least: usize,
    most: usize,
    wanted: &'static str,
) -> Result<Vec<[f64; 2]>, KeyError> {
    let count = points.len();
    if !(least..=most).contains(&count) {
        return Err(KeyError::key("points", Problem::Count { count, wanted }));
    }
    let points: Vec<_> = points.iter().map(|Numbers(at)| *at).collect();
    check_places("points", &points)?;
    Ok(points)
}

/// A rectangle along x, with its middle at this y.
fn rectangle(length_mm: f64, width_mm: f64, y_mm: f64) -> Vec<[f64; 2]> {
    let (x, y) = (length_mm / 2.0, width_mm / 2.0);
    vec![[-x, y_mm - y], [x, y_mm - y], [x, y_mm + y], [-x, y_mm + y]]
}

#[derive(Deserialize)]
struct Bar {
    length_mm: f64,
    width_mm: f64,
}

impl Keys for Bar {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        let (length_mm, width_mm) = (wide("length_mm", self.length_mm)?, wide("width_mm", self.width_mm)?);
        Ok(Surface::Polygons(vec![rectangle(length_mm, width_mm, 0.0)]))
    }

    /// Its middle line.
    fn drawn(&self, _: Surface, [x_mm, y_mm]: [f64; 2], angle_deg: f64) -> Option<Shape> {
        let [x, y] = level_direction(angle_deg).map(|part| self.length_mm / 2.0 * part);
        Some(Shape::Polyline(vec![[x_mm - x, y_mm - y], [x_mm + x, y_mm + y]]))
    }
}

/// How far an edge and a profile reach, mm: beyond the pad wherever they are.
const FAR_MM: f64 = 2.0 * MAX_PLACE_MM;

#[derive(Deserialize)]
struct Edge {}

impl Keys for Edge {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        Ok(Surface::Polygons(vec![rectangle(2.0 * FAR_MM, FAR_MM, -FAR_MM / 2.0)]))
    }
}

/// A segment or a polyline.
#[derive(Deserialize)]
struct Line<const MOST: usize> {
    points: Points,
    #[serde(default, deserialize_with = "given")]
    width_mm: Option<f64>,
}

impl<const MOST: usize> Keys for Line<MOST> {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        let wanted = if MOST == 2 { "the 2 ends of a segment" } else { "the 2 to 4096 points of a polyline" };
        let points = places(&self.points, 2, MOST, wanted)?;
        let width_mm = wide("width_mm", self.width_mm.unwrap_or(LINE_MM))?;
        Ok(Surface::Lines { lines: vec![points], reach_mm: width_mm / 2.0 })
    }

    fn placed_by(&self) -> &'static str {
        "points"
    }
}

#[derive(Deserialize)]
struct Disc {
    radius_mm: f64,
}

impl Keys for Disc {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        // A disc without radius is a dot.
        let reach_mm = length("radius_mm", self.radius_mm, 0.0, PAD_LENGTH_MM)?.max(DOT_MM / 2.0);
        Ok(Surface::Near { shape: Shape::Dots(vec![[0.0; 2]]), reach_mm })
    }

    fn drawn(&self, _: Surface, center_mm: [f64; 2], _: f64) -> Option<Shape> {
        Some(Shape::Disc { center_mm, radius_mm: self.radius_mm })
    }
}

#[derive(Deserialize)]
struct Dots {
    points: Points,
    #[serde(default, deserialize_with = "given")]
    diameter_mm: Option<f64>,
}

impl Keys for Dots {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        let points = places(&self.points, 1, MAX_POINTS, "1 to 4096 dots")?;
        let diameter_mm = wide("diameter_mm", self.diameter_mm.unwrap_or(DOT_MM))?;
        Ok(Surface::Near { shape: Shape::Dots(points), reach_mm: diameter_mm / 2.0 })
    }

    fn placed_by(&self) -> &'static str {
        "points"
    }
}

/// Two bars with a gap between them.
#[derive(Deserialize)]
struct Gap {
    length_mm: f64,
    width_mm: f64,
    gap_mm: f64,
}

impl Keys for Gap {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        let (length_mm, width_mm) = (wide("length_mm", self.length_mm)?, wide("width_mm", self.width_mm)?);
        let y_mm = (length("gap_mm", self.gap_mm, 0.0, 100.0)? + width_mm) / 2.0;
        Ok(Surface::Polygons([-y_mm, y_mm].map(|y_mm| rectangle(length_mm, width_mm, y_mm)).into()))
    }
}

#[derive(Deserialize)]
struct Grating {
    period_mm: f64,
    #[serde(default, deserialize_with = "given")]
    ridge_mm: Option<f64>,
    #[serde(default)]
    offset_mm: f64,
}

impl Keys for Grating {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        let period_mm = length("period_mm", self.period_mm, 0.2, 1000.0)?;
        let ridge_mm = wide("ridge_mm", self.ridge_mm.unwrap_or(LINE_MM))?;
        in_range("ridge_mm", ridge_mm, ridge_mm < period_mm, "less than period_mm")?;
        let offset_mm = self.offset_mm;
        in_range("offset_mm", offset_mm, offset_mm.abs() <= 1e3, "-1000 to 1000 mm")?;
        let shape = Shape::Grating { period_mm, angle_deg: 0.0, offset_mm };
        Ok(Surface::Near { shape, reach_mm: ridge_mm / 2.0 })
    }
}

/// Braille in print: distances from dot to dot and from cell to cell, and the diameter of a dot, mm.
const DOT_PITCH_MM: f64 = 2.34;
const CELL_PITCH_MM: f64 = 6.2;
const PRINTED_DOT_MM: f64 = 1.5;
/// The finest detail that an array can show, in pin pitches: two vibrating pins need one at rest between them.
const PITCHES_APART: f64 = 2.0;

#[derive(Deserialize)]
struct Braille {
    text: Option<String>,
    /// One letter, with dots that the array can show.
    character: Option<String>,
    /// The array of a search; the dots of a character stand two of its pitches apart.
    array: Option<String>,
    #[serde(default, deserialize_with = "given")]
    dot_pitch_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    cell_pitch_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    diameter_mm: Option<f64>,
}

impl Keys for Braille {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        let of_array = || {
            let named = self.array.as_deref().and_then(|name| Array::named(name).ok());
            PITCHES_APART * named.unwrap_or_else(Array::paper).pitch_mm()
        };
        let (text, pitch_mm) = match (&self.text, &self.character) {
            (Some(text), None) => (text, DOT_PITCH_MM),
            (None, Some(text)) => (text, of_array()),
            (None, None) => return Err(missing("text", wanted)),
            (Some(_), Some(_)) => return Err(KeyError::key("character", Problem::TwoTexts)),
        };
        let key = self.placed_by();
        let pitch_mm = length("dot_pitch_mm", self.dot_pitch_mm.unwrap_or(pitch_mm), 0.5, 24.0)?;
        let cell_mm = self.cell_pitch_mm.unwrap_or(CELL_PITCH_MM / DOT_PITCH_MM * pitch_mm);
        length("cell_pitch_mm", cell_mm, pitch_mm, 100.0)?;
        let printed_mm = self.text.is_some().then_some(PRINTED_DOT_MM / DOT_PITCH_MM * pitch_mm);
        let diameter_mm = wide("diameter_mm", self.diameter_mm.or(printed_mm).unwrap_or(DOT_MM))?;
        let count = text.chars().count();
        if key == "character" && count != 1 {
            return Err(KeyError::key(key, Problem::OneCharacter { found: quote(text) }));
        }
        if 6 * count > MAX_POINTS {
            return Err(KeyError::key(key, Problem::Count { count, wanted: "at most 682 characters" }));
        }
        let mut dots = Vec::new();
        for (number, character) in text.chars().enumerate() {
            if matches!(character, ' ' | '\u{2800}') {
                continue;
            }
            let x_mm = (number as f64 - (count as f64 - 1.0) / 2.0) * cell_mm;
            let found = braille_dots(character.encode_utf8(&mut [0; 4]), pitch_mm, [x_mm, 0.0]);
            let unknown = || KeyError::key(key, Problem::Character { found: quote(&character.to_string()) });
            dots.extend(found.ok_or_else(unknown)?.into_iter().map(|(_, at)| at));
        }
        if dots.is_empty() {
            return Err(KeyError::key(key, Problem::NoDots));
        }
        Ok(Surface::Near { shape: Shape::Dots(dots), reach_mm: diameter_mm / 2.0 })
    }

    fn placed_by(&self) -> &'static str {
        if self.text.is_some() { "text" } else { "character" }
    }
}

#[derive(Deserialize)]
struct Lines {
    lines: Vec<Points>,
    width_mm: f64,
}

impl Keys for Lines {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        let line = |line: &Points| line.iter().map(|Numbers(at)| *at).collect();
        let lines: Vec<Vec<_>> = self.lines.iter().map(line).collect();
        let count = lines.iter().map(Vec::len).sum::<usize>();
        if !(1..=MAX_POINTS).contains(&count) || lines.iter().any(Vec::is_empty) {
            let wanted = "1 to 4096, and one or more in each line";
            return Err(KeyError::key("lines", Problem::Points { count, wanted }));
        }
        check_places("lines", lines.iter().flatten())?;
        Ok(Surface::Lines { lines, reach_mm: wide("width_mm", self.width_mm)? / 2.0 })
    }

    fn placed_by(&self) -> &'static str {
        "lines"
    }
}

#[derive(Deserialize)]
struct Polygon {
    points: Points,
}

impl Keys for Polygon {
    fn surface(&self, _: Open<'_>) -> Result<Surface, KeyError> {
        Ok(Surface::Polygons(vec![places(&self.points, 3, MAX_POINTS, "3 to 4096 corners")?]))
    }
}

/// The checked size of a pixel.
fn pixel(mm_per_pixel: f64, um_per_level: Option<f64>) -> Result<f64, KeyError> {
    let um = um_per_level.unwrap_or(1.0);
    let is_good = (1e-3..=1e6).contains(&um.abs());
    let pixel_mm = length("mm_per_pixel", mm_per_pixel, 0.001, 10.0)?;
    in_range("um_per_level", um, is_good, "0.001 to 1000000 um, or below 0 to invert")?;
    Ok(pixel_mm)
}

/// Refuses a map that is too large.
fn within_side(map: HeightMap, [width_mm, length_mm]: [f64; 2]) -> Result<Surface, KeyError> {
    let is_good = width_mm <= MAX_SIDE_MM && length_mm <= MAX_SIDE_MM;
    let too_large = || KeyError::key("mm_per_pixel", Problem::Side { width_mm, length_mm });
    if is_good { Ok(Surface::Map(map)) } else { Err(too_large()) }
}

#[derive(Deserialize)]
struct Heightmap {
    file: String,
    mm_per_pixel: f64,
    #[serde(default, deserialize_with = "given")]
    um_per_level: Option<f64>,
}

impl Keys for Heightmap {
    fn surface(&self, open: Open<'_>) -> Result<Surface, KeyError> {
        let pixel_mm = pixel(self.mm_per_pixel, self.um_per_level)?;
        let key = |problem| match problem {
            Problem::NoScale => KeyError::key("um_per_level", problem),
            problem => KeyError::key("file", problem),
        };
        let bytes = bytes_of(&self.file, open)?;
        let map = image::read(&self.file, &bytes, pixel_mm, self.um_per_level).map_err(key)?;
        let sides_mm = map.sides_mm();
        within_side(map, sides_mm)
    }
}

/// A profile along x.
#[derive(Deserialize)]
struct Texture {
    file: String,
    column: Option<Column>,
    mm_per_pixel: f64,
    #[serde(default, deserialize_with = "given")]
    um_per_level: Option<f64>,
}

impl Keys for Texture {
    fn surface(&self, open: Open<'_>) -> Result<Surface, KeyError> {
        let pixel_mm = pixel(self.mm_per_pixel, self.um_per_level)?;
        let bytes = bytes_of(&self.file, open)?;
        let um = read_profile(&self.file, &bytes, self.column.as_ref(), self.um_per_level)
            .map_err(|error| KeyError::key("file", error.into()))?;
        let heights_mm: Vec<f32> = um.into_iter().map(|um| um / 1000.0).collect();
        let map = HeightMap::new([heights_mm.len(), 1], [pixel_mm, FAR_MM], heights_mm);
        let map = map.expect("samples are finite");
        let width_mm = map.sides_mm()[0];
        within_side(map, [width_mm, 0.0])
    }
}
