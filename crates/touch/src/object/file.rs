//! Reads object files.
//!
//! The shape decides which keys a file may have: a key of another shape is refused. Errors name the key. Keys that only a search for
//! a pattern needs are known here, and `meissner-paper` reads them.
//!
//! Invariant: no key is unknown.

use super::error::{KeyError, MAX_FILE_BYTES, MAX_POINTS, MAX_SIDE_MM, ObjectError, Problem};
use super::surface::{HeightMap, Surface};
use super::{DOT_MM as SHAPE_DOT_MM, LINE_MM, Object, image};
use crate::braille::dots as braille_dots;
use crate::shape::{Shape, level_direction};
use crate::touch::{MAX_DEPTH_MM, MAX_PLACE_MM, Pose, Press, Scan, Touch};
use meissner_array::samples::{Column, read_columns, read_profile};
use meissner_array::spec::Array;
use meissner_input::document::{CommonProblem, Table, from_json, from_toml, given, in_range};
use meissner_input::message::{cut, quote};
use meissner_skin::membrane::PAD_LENGTH_MM;
use serde::de::{Error, IgnoredAny};
use serde::{Deserialize, Deserializer};
use std::io;
use std::ops::RangeInclusive;

/// Braille in print: distances from dot to dot and from cell to cell, and the diameter of a dot, mm.
const DOT_PITCH_MM: f64 = 2.34;
const CELL_PITCH_MM: f64 = 6.2;
const DOT_MM: f64 = 1.5;
/// The finest detail that an array can show, in pin pitches: two vibrating pins need one at rest between them.
const PITCHES_APART: f64 = 2.0;
/// Defaults of a touch, s.
const RISE_S: f64 = 0.05;
const HOLD_S: f64 = 0.2;
/// How far an edge and a profile reach, mm: beyond the pad wherever they are.
const FAR_MM: f64 = 2.0 * MAX_PLACE_MM;

/// Gives the bytes of a file that an object names.
pub type Open<'o> = &'o mut dyn FnMut(&str) -> io::Result<Vec<u8>>;

impl Object {
    /// Reads an object file. Errors call it `file`; `open` gives the files that it names.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str, open: Open<'_>) -> Result<Self, ObjectError> {
        read(text, open).map_err(|fault: KeyError| fault.in_text(text).in_file(Some(file)))
    }

    /// Reads the same keys as JSON; `open` gives the files that they name.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read_json(text: &str, open: Open<'_>) -> Result<Self, ObjectError> {
        let mut read = || {
            check_length(text)?;
            let Table(raw): Table<RawObject> = from_json(text, wanted)?;
            raw.object(open)
        };
        read().map_err(|fault: KeyError| fault.in_file(None))
    }
}

/// What a search for a pattern takes of an object: where it lies, and how it moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// Its name.
    pub name: String,
    /// Its shape on the skin: for a scan, in the middle of it.
    pub shape: Shape,
    /// The key that places its points.
    pub placed_by: &'static str,
    /// The scan along the skin, if it is one.
    pub scan: Option<Scan>,
    /// Whether it follows a path, which a search cannot.
    pub has_path: bool,
}

impl Drawn {
    /// Reads an object file, which needs no touch.
    ///
    /// # Errors
    /// The first thing that is wrong with it.
    pub fn read(text: &str) -> Result<Self, KeyError> {
        raw(text)?.drawn()
    }
}

/// Gives no files: for objects that are sent whole.
///
/// # Errors
/// Always: what to do instead.
pub fn no_files(_: &str) -> io::Result<Vec<u8>> {
    Err(io::Error::other("an object of a live play names no file, take another shape"))
}

fn check_length(text: &str) -> Result<(), KeyError> {
    let bytes = text.len();
    if bytes > MAX_FILE_BYTES { Err(KeyError::whole(None, Problem::TooLarge { bytes })) } else { Ok(()) }
}

fn raw(text: &str) -> Result<RawObject, KeyError> {
    check_length(text)?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let Table(raw) = from_toml(text, wanted)?;
    Ok(raw)
}

fn read(text: &str, open: Open<'_>) -> Result<Object, KeyError> {
    raw(text)?.object(open)
}

fn wanted(key: &str) -> &'static str {
    match key {
        "name" => "name = \"...\", the name of the file",
        "shape" => {
            "shape = \"bar\", \"edge\", \"segment\", \"polyline\", \"disc\", \"dots\", \"gap\", \"grating\", \"braille\", \"lines\", \"polygon\", \"heightmap\" or \"texture\""
        }
        "touch" => "[touch] with press = { depth_um = 500 }, a scan or a path",
        "points" => "points = [[x, y], ...], in mm",
        "lines" => "lines = [[[x, y], [x, y], ...], ...], in mm",
        "text" => "text = \"...\", letters or six-dot Braille characters",
        "file" => "file = \"...\", the file's name",
        "depth_um" => "the depth, um",
        "speed_mm_s" => "the speed, mm/s",
        _ => "a length, mm",
    }
}

#[derive(Clone, Copy, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Bar,
    Edge,
    Segment,
    Polyline,
    Disc,
    Dots,
    Gap,
    Grating,
    Braille,
    Lines,
    Polygon,
    Heightmap,
    Texture,
}

impl Kind {
    const fn word(self) -> &'static str {
        match self {
            Self::Bar => "bar",
            Self::Edge => "edge",
            Self::Segment => "segment",
            Self::Polyline => "polyline",
            Self::Disc => "disc",
            Self::Dots => "dots",
            Self::Gap => "gap",
            Self::Grating => "grating",
            Self::Braille => "braille",
            Self::Lines => "lines",
            Self::Polygon => "polygon",
            Self::Heightmap => "heightmap",
            Self::Texture => "texture",
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawObject {
    kind: Option<String>,
    name: String,
    shape: Kind,
    #[serde(default, deserialize_with = "numbers")]
    center_mm: [f64; 2],
    #[serde(default)]
    angle_deg: f64,
    #[serde(default, deserialize_with = "given")]
    length_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    width_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    gap_mm: Option<f64>,
    points: Option<Vec<Numbers<2>>>,
    lines: Option<Vec<Vec<Numbers<2>>>>,
    #[serde(default, deserialize_with = "given")]
    radius_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    diameter_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    period_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    ridge_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    offset_mm: Option<f64>,
    text: Option<String>,
    /// One letter, with dots that the array can show.
    character: Option<String>,
    #[serde(default, deserialize_with = "given")]
    dot_pitch_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    cell_pitch_mm: Option<f64>,
    file: Option<String>,
    column: Option<Column>,
    #[serde(default, deserialize_with = "given")]
    um_per_level: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    mm_per_pixel: Option<f64>,
    touch: Option<Table<RawTouch>>,
    /// The array of a search; the dots of a character stand two of its pitches apart.
    array: Option<String>,
    // What only a search reads.
    #[serde(rename = "reach_mm")]
    _reach_mm: Option<IgnoredAny>,
    #[serde(rename = "amplitude_um")]
    _amplitude_um: Option<IgnoredAny>,
    #[serde(rename = "duration_s")]
    _duration_s: Option<IgnoredAny>,
    #[serde(rename = "population")]
    _population: Option<IgnoredAny>,
    #[serde(rename = "afferent")]
    _afferent: Option<IgnoredAny>,
    #[serde(rename = "receptor")]
    _receptor: Option<IgnoredAny>,
    #[serde(rename = "motion")]
    _motion: Option<IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTouch {
    press: Option<Table<RawPress>>,
    scan: Option<Table<RawScan>>,
    path: Option<Table<RawPath>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPress {
    depth_um: f64,
    #[serde(default, deserialize_with = "given")]
    rise_s: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    hold_s: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    fall_s: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawScan {
    depth_um: f64,
    #[serde(default, deserialize_with = "given")]
    rise_s: Option<f64>,
    speed_mm_s: f64,
    #[serde(default)]
    direction_deg: f64,
    #[serde(default, deserialize_with = "given")]
    duration_s: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    distance_mm: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPath {
    file: Option<String>,
    /// `[t_s, x_mm, y_mm, angle_deg, depth_um]`.
    poses: Option<Vec<Numbers<5>>>,
}

/// Exactly so many numbers: serde's own arrays leave out what is too much.
#[derive(Clone, Deserialize)]
struct Numbers<const N: usize>(#[serde(deserialize_with = "numbers")] [f64; N]);

fn numbers<'de, D: Deserializer<'de>, const N: usize>(source: D) -> Result<[f64; N], D::Error> {
    let all = Vec::<f64>::deserialize(source)?;
    let count = all.len();
    all.try_into().map_err(|_| D::Error::custom(format!("is a list of {count}: must be {N} numbers")))
}

fn missing(key: &str) -> KeyError {
    KeyError::common(None, key.to_owned(), CommonProblem::Missing { wanted: wanted(key) })
}

/// A length within its range, or its default.
fn length(
    key: &str,
    found: Option<f64>,
    default: Option<f64>,
    least: f64,
    most: f64,
) -> Result<f64, KeyError> {
    let found = found.or(default).ok_or_else(|| missing(key))?;
    in_range(key, found, (least..=most).contains(&found), format!("{least} to {most} mm"))?;
    Ok(found)
}

fn bytes_of(name: &str, open: Open<'_>) -> Result<Vec<u8>, KeyError> {
    open(name).map_err(|error| KeyError::key("file", Problem::File { message: cut(&error.to_string(), 200) }))
}

fn check_places<'p>(key: &str, places: impl Iterator<Item = &'p [f64; 2]>) -> Result<(), KeyError> {
    for &place in places.flatten() {
        in_range(key, place, place.abs() <= MAX_PLACE_MM, "-100 to 100 mm each")?;
    }
    Ok(())
}

/// A rectangle along x, with its middle at this y.
fn bar(length_mm: f64, width_mm: f64, y_mm: f64) -> Vec<[f64; 2]> {
    let (x, y) = (length_mm / 2.0, width_mm / 2.0);
    vec![[-x, y_mm - y], [x, y_mm - y], [x, y_mm + y], [-x, y_mm + y]]
}

impl RawObject {
    /// Checks what does not depend on the shape.
    fn check(&self) -> Result<(), KeyError> {
        if let Some(kind) = self.kind.as_deref().filter(|kind| *kind != "object") {
            return Err(KeyError::key("kind", Problem::Kind { found: quote(kind) }));
        }
        let is_named = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if !(1..=64).contains(&self.name.len()) || !self.name.chars().all(is_named) {
            return Err(KeyError::key("name", Problem::Name { found: quote(&self.name) }));
        }
        self.check_keys()?;
        for place in self.center_mm {
            in_range("center_mm", place, place.abs() <= MAX_PLACE_MM, "-100 to 100 mm each")?;
        }
        in_range("angle_deg", self.angle_deg, self.angle_deg.abs() <= 360.0, "-360 to 360 degrees")
    }

    /// What a search takes of it.
    fn drawn(self) -> Result<Drawn, KeyError> {
        self.check()?;
        let not_drawn = || KeyError::key("shape", Problem::NotDrawn { shape: self.shape.word() });
        let [x_mm, y_mm] = self.center_mm;
        let shape = match self.shape {
            Kind::Bar => {
                let [long, _] = self.sides()?;
                let [x, y] = level_direction(self.angle_deg).map(|part| long / 2.0 * part);
                Shape::Polyline(vec![[x_mm - x, y_mm - y], [x_mm + x, y_mm + y]])
            }
            Kind::Disc => Shape::Disc { center_mm: self.center_mm, radius_mm: self.radius()? },
            Kind::Heightmap | Kind::Texture => return Err(not_drawn()),
            _ => match self.surface(&mut no_files)? {
                Surface::Near { shape, .. } => shape.moved(self.center_mm, self.angle_deg),
                Surface::Lines { lines, .. } if lines.len() == 1 => {
                    Shape::Polyline(lines.concat()).moved(self.center_mm, self.angle_deg)
                }
                _ => return Err(not_drawn()),
            },
        };
        let placed_by = match self.shape {
            Kind::Segment | Kind::Polyline | Kind::Dots => "points",
            Kind::Lines => "lines",
            Kind::Braille if self.text.is_some() => "text",
            Kind::Braille => "character",
            _ => "center_mm",
        };
        let touch = self.touch.as_ref().map(|Table(touch)| touch);
        let scan = touch.and_then(|touch| touch.scan.as_ref()).map(|Table(scan)| scan.scan());
        let scan = scan.transpose().map_err(|fault| fault.within("touch.scan"))?;
        let has_path = touch.is_some_and(|touch| touch.path.is_some());
        Ok(Drawn { shape, placed_by, scan, has_path, name: self.name })
    }

    fn object(self, open: Open<'_>) -> Result<Object, KeyError> {
        self.check()?;
        let surface = self.surface(open)?;
        let [x_mm, y_mm] = self.center_mm;
        let at = Pose { x_mm, y_mm, angle_deg: self.angle_deg, depth_mm: 0.0 };
        let Table(touch) = self.touch.ok_or_else(|| missing("touch"))?;
        let touch = touch.touch(at, open).map_err(|fault| fault.within("touch"))?;
        Ok(Object { name: self.name, surface, touch })
    }

    fn surface(&self, open: Open<'_>) -> Result<Surface, KeyError> {
        let wide = |key, found| length(key, found, None, 0.1, 100.0);
        Ok(match self.shape {
            Kind::Bar => {
                let [long, wide] = self.sides()?;
                Surface::Polygons(vec![bar(long, wide, 0.0)])
            }
            Kind::Gap => {
                let [long, wide] = self.sides()?;
                let gap_mm = length("gap_mm", self.gap_mm, None, 0.0, 100.0)?;
                let y_mm = (gap_mm + wide) / 2.0;
                Surface::Polygons(vec![bar(long, wide, -y_mm), bar(long, wide, y_mm)])
            }
            Kind::Edge => Surface::Polygons(vec![bar(2.0 * FAR_MM, FAR_MM, -FAR_MM / 2.0)]),
            Kind::Polygon => {
                let corners = self.points(3..=MAX_POINTS, "3 to 4096 corners")?;
                Surface::Polygons(vec![corners])
            }
            Kind::Segment | Kind::Polyline => {
                let points = match self.shape {
                    Kind::Segment => self.points(2..=2, "the 2 ends of a segment")?,
                    _ => self.points(2..=MAX_POINTS, "the 2 to 4096 points of a polyline")?,
                };
                let width_mm = length("width_mm", self.width_mm, Some(LINE_MM), 0.1, 100.0)?;
                Surface::Lines { lines: vec![points], reach_mm: width_mm / 2.0 }
            }
            Kind::Disc => {
                // A disc without radius is a dot.
                let reach_mm = self.radius()?.max(SHAPE_DOT_MM / 2.0);
                Surface::Near { shape: Shape::Dots(vec![[0.0; 2]]), reach_mm }
            }
            Kind::Lines => {
                let lines = self.lines.as_ref().ok_or_else(|| missing("lines"))?;
                let line = |line: &Vec<Numbers<2>>| line.iter().map(|Numbers(at)| *at).collect();
                let lines: Vec<Vec<_>> = lines.iter().map(line).collect();
                let count = lines.iter().map(Vec::len).sum::<usize>();
                if !(1..=MAX_POINTS).contains(&count) || lines.iter().any(Vec::is_empty) {
                    let wanted = "1 to 4096, and one or more in each line";
                    return Err(KeyError::key("lines", Problem::Points { count, wanted }));
                }
                check_places("lines", lines.iter().flatten())?;
                Surface::Lines { lines, reach_mm: wide("width_mm", self.width_mm)? / 2.0 }
            }
            Kind::Dots => {
                let points = self.points(1..=MAX_POINTS, "1 to 4096 dots")?;
                let diameter_mm = length("diameter_mm", self.diameter_mm, Some(SHAPE_DOT_MM), 0.1, 100.0)?;
                Surface::Near { shape: Shape::Dots(points), reach_mm: diameter_mm / 2.0 }
            }
            Kind::Grating => {
                let period_mm = length("period_mm", self.period_mm, None, 0.2, 1000.0)?;
                let ridge_mm = length("ridge_mm", self.ridge_mm, Some(LINE_MM), 0.1, 100.0)?;
                in_range("ridge_mm", ridge_mm, ridge_mm < period_mm, "less than period_mm")?;
                let offset_mm = self.offset_mm.unwrap_or(0.0);
                in_range("offset_mm", offset_mm, offset_mm.abs() <= 1e3, "-1000 to 1000 mm")?;
                let shape = Shape::Grating { period_mm, angle_deg: 0.0, offset_mm };
                Surface::Near { shape, reach_mm: ridge_mm / 2.0 }
            }
            Kind::Braille => self.braille()?,
            Kind::Heightmap => {
                let name = self.file.as_deref().ok_or_else(|| missing("file"))?;
                let pixel_mm = length("mm_per_pixel", self.mm_per_pixel, None, 0.001, 10.0)?;
                self.check_scale()?;
                let key = |problem| match problem {
                    Problem::NoScale => KeyError::key("um_per_level", problem),
                    problem => KeyError::key("file", problem),
                };
                let map =
                    image::read(name, &bytes_of(name, open)?, pixel_mm, self.um_per_level).map_err(key)?;
                within_side(map.sides_mm())?;
                Surface::Map(map)
            }
            Kind::Texture => {
                let name = self.file.as_deref().ok_or_else(|| missing("file"))?;
                let pixel_mm = length("mm_per_pixel", self.mm_per_pixel, None, 0.001, 10.0)?;
                self.check_scale()?;
                let um = read_profile(name, &bytes_of(name, open)?, self.column.as_ref(), self.um_per_level)
                    .map_err(|error| KeyError::key("file", error.into()))?;
                let heights_mm: Vec<f32> = um.into_iter().map(|um| um / 1000.0).collect();
                let map = HeightMap::new([heights_mm.len(), 1], [pixel_mm, FAR_MM], heights_mm);
                let map = map.expect("samples are finite");
                within_side([map.sides_mm()[0], 0.0])?;
                Surface::Map(map)
            }
        })
    }

    /// The length and the width of a bar.
    fn sides(&self) -> Result<[f64; 2], KeyError> {
        let side = |key, found| length(key, found, None, 0.1, 100.0);
        Ok([side("length_mm", self.length_mm)?, side("width_mm", self.width_mm)?])
    }

    fn radius(&self) -> Result<f64, KeyError> {
        length("radius_mm", self.radius_mm, None, 0.0, PAD_LENGTH_MM)
    }

    fn points(&self, counts: RangeInclusive<usize>, wanted: &'static str) -> Result<Vec<[f64; 2]>, KeyError> {
        let points = self.points.as_ref().ok_or_else(|| missing("points"))?;
        let points: Vec<_> = points.iter().map(|Numbers(at)| *at).collect();
        let count = points.len();
        if !counts.contains(&count) {
            return Err(KeyError::key("points", Problem::Count { count, wanted }));
        }
        check_places("points", points.iter())?;
        Ok(points)
    }

    fn braille(&self) -> Result<Surface, KeyError> {
        let of_array = || {
            let named = self.array.as_deref().and_then(|name| Array::named(name).ok());
            PITCHES_APART * named.unwrap_or_else(Array::paper).pitch_mm()
        };
        let (key, text, default_mm) = match (&self.text, &self.character) {
            (Some(text), None) => ("text", text, DOT_PITCH_MM),
            (None, Some(text)) => ("character", text, of_array()),
            (None, None) => return Err(missing("text")),
            (Some(_), Some(_)) => return Err(KeyError::key("character", Problem::TwoTexts)),
        };
        let pitch_mm = length("dot_pitch_mm", self.dot_pitch_mm, Some(default_mm), 0.5, 24.0)?;
        let cell_mm = length(
            "cell_pitch_mm",
            self.cell_pitch_mm,
            Some(CELL_PITCH_MM / DOT_PITCH_MM * pitch_mm),
            pitch_mm,
            100.0,
        )?;
        let of_text = self.text.is_some().then_some(DOT_MM / DOT_PITCH_MM * pitch_mm);
        let diameter_mm =
            length("diameter_mm", self.diameter_mm, of_text.or(Some(SHAPE_DOT_MM)), 0.1, 100.0)?;
        let cells = text.chars().count();
        if key == "character" && cells != 1 {
            return Err(KeyError::key(key, Problem::OneCharacter { found: quote(text) }));
        }
        let count = 6 * cells;
        if count > MAX_POINTS {
            return Err(KeyError::key(
                key,
                Problem::Count { count: cells, wanted: "at most 682 characters" },
            ));
        }
        let mut dots = Vec::new();
        for (number, character) in text.chars().enumerate() {
            if matches!(character, ' ' | '\u{2800}') {
                continue;
            }
            let x_mm = (number as f64 - (cells as f64 - 1.0) / 2.0) * cell_mm;
            let found = braille_dots(character.encode_utf8(&mut [0; 4]), pitch_mm, [x_mm, 0.0]);
            let unknown = || KeyError::key(key, Problem::Character { found: quote(&character.to_string()) });
            dots.extend(found.ok_or_else(unknown)?.into_iter().map(|(_, at)| at));
        }
        if dots.is_empty() {
            return Err(KeyError::key(key, Problem::NoDots));
        }
        Ok(Surface::Near { shape: Shape::Dots(dots), reach_mm: diameter_mm / 2.0 })
    }

    fn check_scale(&self) -> Result<(), KeyError> {
        let um = self.um_per_level.unwrap_or(1.0);
        in_range(
            "um_per_level",
            um,
            (1e-3..=1e6).contains(&um.abs()),
            "0.001 to 1000000 um, or below 0 to invert",
        )
    }

    /// Refuses keys of other shapes.
    fn check_keys(&self) -> Result<(), KeyError> {
        use Kind::{
            Bar, Braille, Disc, Dots, Gap, Grating, Heightmap, Lines, Polygon, Polyline, Segment, Texture,
        };
        let keys = [
            ("length_mm", self.length_mm.is_some(), &[Bar, Gap][..], "bar or gap"),
            (
                "width_mm",
                self.width_mm.is_some(),
                &[Bar, Gap, Segment, Polyline, Lines],
                "bar, gap, segment, polyline or lines",
            ),
            ("gap_mm", self.gap_mm.is_some(), &[Gap], "gap"),
            (
                "points",
                self.points.is_some(),
                &[Segment, Polyline, Dots, Polygon],
                "segment, polyline, dots or polygon",
            ),
            ("radius_mm", self.radius_mm.is_some(), &[Disc], "disc"),
            ("lines", self.lines.is_some(), &[Lines], "lines"),
            ("diameter_mm", self.diameter_mm.is_some(), &[Dots, Braille], "dots or braille"),
            ("period_mm", self.period_mm.is_some(), &[Grating], "grating"),
            ("ridge_mm", self.ridge_mm.is_some(), &[Grating], "grating"),
            ("offset_mm", self.offset_mm.is_some(), &[Grating], "grating"),
            ("text", self.text.is_some(), &[Braille], "braille"),
            ("character", self.character.is_some(), &[Braille], "braille"),
            ("dot_pitch_mm", self.dot_pitch_mm.is_some(), &[Braille], "braille"),
            ("cell_pitch_mm", self.cell_pitch_mm.is_some(), &[Braille], "braille"),
            ("file", self.file.is_some(), &[Heightmap, Texture], "heightmap or texture"),
            ("column", self.column.is_some(), &[Texture], "texture"),
            ("um_per_level", self.um_per_level.is_some(), &[Heightmap, Texture], "heightmap or texture"),
            ("mm_per_pixel", self.mm_per_pixel.is_some(), &[Heightmap, Texture], "heightmap or texture"),
        ];
        for (key, there, kinds, of) in keys {
            if there && !kinds.contains(&self.shape) {
                return Err(KeyError::key(key, Problem::Foreign { of, shape: self.shape.word() }));
            }
        }
        Ok(())
    }
}

/// Refuses a map that is too large.
fn within_side([width_mm, length_mm]: [f64; 2]) -> Result<(), KeyError> {
    let is_good = width_mm <= MAX_SIDE_MM && length_mm <= MAX_SIDE_MM;
    if is_good { Ok(()) } else { Err(KeyError::key("mm_per_pixel", Problem::Side { width_mm, length_mm })) }
}

impl RawTouch {
    fn touch(self, at: Pose, open: Open<'_>) -> Result<Touch, KeyError> {
        match (self.press, self.scan, self.path) {
            (Some(Table(press)), None, None) => press.touch(at).map_err(|fault| fault.within("press")),
            (None, Some(Table(scan)), None) => scan
                .scan()
                .and_then(|scan| Touch::scan(at, scan).map_err(touch_error))
                .map_err(|fault| fault.within("scan")),
            (None, None, Some(Table(path))) => path.touch(at, open).map_err(|fault| fault.within("path")),
            (press, scan, path) => {
                let count = [press.is_some(), scan.is_some(), path.is_some()]
                    .into_iter()
                    .filter(|there| *there)
                    .count();
                Err(KeyError::whole(None, Problem::Touches { count }))
            }
        }
    }
}

fn touch_error(error: crate::touch::TouchError) -> KeyError {
    KeyError::whole(None, Problem::Touch(Box::new(error)))
}

/// A depth in the unit of the files, in mm.
fn depth_mm(depth_um: f64) -> Result<f64, KeyError> {
    in_range(
        "depth_um",
        depth_um,
        (0.0..=1000.0 * MAX_DEPTH_MM).contains(&depth_um),
        "above 0, at most 2000 um",
    )?;
    Ok(depth_um / 1000.0)
}

impl RawPress {
    fn touch(self, at: Pose) -> Result<Touch, KeyError> {
        let press = Press {
            depth_mm: depth_mm(self.depth_um)?,
            rise_s: self.rise_s.unwrap_or(RISE_S),
            hold_s: self.hold_s.unwrap_or(HOLD_S),
            fall_s: self.fall_s.unwrap_or(RISE_S),
        };
        Touch::press(at, press).map_err(touch_error)
    }
}

impl RawScan {
    fn scan(&self) -> Result<Scan, KeyError> {
        let duration_s = match (self.duration_s, self.distance_mm) {
            (Some(duration_s), None) => duration_s,
            (None, Some(distance_mm)) => distance_mm / self.speed_mm_s,
            _ => return Err(KeyError::whole(None, Problem::ScanEnd)),
        };
        Ok(Scan {
            depth_mm: depth_mm(self.depth_um)?,
            rise_s: self.rise_s.unwrap_or(RISE_S),
            speed_mm_s: self.speed_mm_s,
            direction_deg: self.direction_deg,
            duration_s,
        })
    }
}

impl RawPath {
    fn touch(self, at: Pose, open: Open<'_>) -> Result<Touch, KeyError> {
        let poses: Vec<[f64; 5]> = match (self.file, self.poses) {
            (None, Some(poses)) => poses.into_iter().map(|Numbers(pose)| pose).collect(),
            (Some(name), None) => {
                let names = ["t_s", "x_mm", "y_mm", "angle_deg", "depth_um"];
                let columns = read_columns(&bytes_of(&name, open)?, names)
                    .map_err(|error| KeyError::key("file", error.into()))?;
                (0..columns[0].len()).map(|row| columns.each_ref().map(|column| column[row])).collect()
            }
            _ => return Err(KeyError::whole(None, Problem::PathSource)),
        };
        // The path moves the object from where the file places it.
        let pose = |[t_s, x_mm, y_mm, angle_deg, depth_um]: [f64; 5]| {
            let [x_mm, y_mm] = [at.x_mm + x_mm, at.y_mm + y_mm];
            (t_s, Pose { x_mm, y_mm, angle_deg: at.angle_deg + angle_deg, depth_mm: depth_um / 1000.0 })
        };
        Touch::path(poses.into_iter().map(pose).collect()).map_err(touch_error)
    }
}
