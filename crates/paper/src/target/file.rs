//! Reading and writing target files.
//!
//! The shape decides which keys a file may have: a key of another shape is refused. A point off the pad is refused, too; the error
//! names the key that placed it. [`Target::checked`] checks the rest.
//!
//! Invariant: no key is ignored.

use crate::target::checked::Target;
use crate::target::error::{KeyError, Problem, TargetError, within};
use crate::target::limits::{FINEST_PITCHES, MAX_BYTES, MAX_FRAMES, MAX_POINTS};
use crate::target::motion::{Frame, Motion};
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_input::document::{CommonProblem, Table, from_toml, given, in_range, line_of};
use meissner_input::message::quote;
use meissner_skin::RawAfferent;
use meissner_skin::membrane;
use meissner_touch::{Shape, braille_dots, on_pad};
use serde::de::{Error, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use toml::Value;

/// The key of a pattern's provenance under which it keeps its target.
pub(crate) const DEFINITION: &str = "definition";

/// Defaults. The amplitude is the paper's; it drives afferents well into their plateau. Motors with less travel have that.
const REACH_MM: f64 = 1.5;
const AMPLITUDE_UM: f64 = 80.0;
const DURATION_S: f64 = 5.0;

impl Target {
    /// Reads a target file. Errors call it `file`.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str) -> Result<Self, TargetError> {
        read(text).map_err(|fault| fault.in_file(Some(file)))
    }

    /// The target that a pattern was made for, on the pattern's array, if its provenance holds one that can be read.
    #[must_use]
    pub fn made_for(pattern: &Pattern) -> Option<Self> {
        let text = toml::to_string(pattern.provenance().get(DEFINITION)?.as_table()?).ok()?;
        let target = Self::read(&text, DEFINITION).ok()?;
        if target.array == pattern.array() { Some(target) } else { target.with_array(pattern.array()).ok() }
    }

    /// The target as a table with every key. [`Self::read`] makes an equal target of it: a polyline of two points is
    /// written as a segment, a Braille character as its dots.
    #[must_use]
    #[expect(clippy::missing_panics_doc, reason = "the values of a checked target are TOML values")]
    pub fn definition(&self) -> toml::Table {
        let population =
            [("seed", i64::try_from(self.population_seed).expect("the seed was checked").into())];
        let afferent = toml::Table::try_from(RawAfferent::from(self.model)).expect("a string and numbers");
        let duration_s = ("duration_s", self.duration_s.into());
        let times = match self.motion {
            None => duration_s,
            Some(Motion { speed_mm_s, direction_deg, turn_deg_s, frames }) => {
                let motion = [
                    duration_s,
                    ("speed_mm_s", speed_mm_s.into()),
                    ("direction_deg", direction_deg.into()),
                    ("turn_deg_s", turn_deg_s.into()),
                    ("frames", i64::from(frames).into()),
                ];
                ("motion", table(motion).into())
            }
        };
        let keys = [
            ("name", self.name.as_str().into()),
            ("reach_mm", self.reach_mm.into()),
            ("amplitude_um", self.amplitude_um.into()),
            ("population", table(population).into()),
            // The old name: the bytes of the library's patterns stay the same.
            ("receptor", afferent.into()),
            times,
        ];
        // A target for the default array does not name it.
        let array = (self.array != Array::paper()).then(|| ("array", self.array.name().into()));
        table(shape_keys(&self.shape).into_iter().chain(keys).chain(array))
    }
}

fn table(keys: impl IntoIterator<Item = (&'static str, Value)>) -> toml::Table {
    keys.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

fn shape_keys(shape: &Shape) -> Vec<(&'static str, Value)> {
    let point = |&[x, y]: &[f64; 2]| Value::Array(vec![x.into(), y.into()]);
    let points = |points: &[[f64; 2]]| ("points", Value::Array(points.iter().map(point).collect()));
    let (name, mut keys) = match shape {
        Shape::Polyline(ends) if ends.len() == 2 => ("segment", vec![points(ends)]),
        Shape::Polyline(corners) => ("polyline", vec![points(corners)]),
        Shape::Dots(dots) => ("dots", vec![points(dots)]),
        Shape::Disc { center_mm, radius_mm } => {
            ("disc", vec![("center_mm", point(center_mm)), ("radius_mm", (*radius_mm).into())])
        }
        &Shape::Grating { period_mm, angle_deg, offset_mm } => {
            let keys = [("period_mm", period_mm), ("angle_deg", angle_deg), ("offset_mm", offset_mm)];
            ("grating", keys.map(|(key, value)| (key, value.into())).into())
        }
    };
    keys.push(("shape", name.into()));
    keys
}

fn check_length(text: &str) -> Result<(), KeyError> {
    let bytes = text.len();
    if bytes > MAX_BYTES { Err(KeyError::whole(None, Problem::TooLarge { bytes })) } else { Ok(()) }
}

fn read(text: &str) -> Result<Target, KeyError> {
    check_length(text)?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let Table(raw): Table<RawTarget> = from_toml(text, wanted)?;
    // A missing key has no line: the error then names the line of the shape.
    let line = |path: &str| line_of(text, path).or_else(|| line_of(text, "shape"));
    raw.target().map_err(|fault| KeyError { line: fault.line.or_else(|| line(&fault.path)), ..fault })
}

fn wanted(key: &str) -> &'static str {
    match key {
        "name" => "name = \"...\", the name of the file",
        "shape" => "shape = \"segment\", \"polyline\", \"disc\", \"dots\", \"braille\" or \"grating\"",
        "points" => "points = [[x, y], ...], in mm from the array's middle",
        "radius_mm" => "a radius, 0 to 24 mm",
        "character" => "a letter, or a six-dot Braille character",
        "period_mm" => "the distance from line to line, in mm",
        _ => "the duration of the motion, in s",
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTarget {
    name: String,
    array: Option<String>,
    shape: Kind,
    points: Option<Vec<Point>>,
    center_mm: Option<Point>,
    #[serde(default, deserialize_with = "given")]
    radius_mm: Option<f64>,
    character: Option<String>,
    #[serde(default, deserialize_with = "given")]
    dot_pitch_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    period_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    angle_deg: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    offset_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    reach_mm: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    amplitude_um: Option<f64>,
    #[serde(default, deserialize_with = "given")]
    duration_s: Option<f64>,
    population: Option<Table<RawPopulation>>,
    // Patterns name it `receptor` in their provenance.
    #[serde(alias = "receptor")]
    afferent: Option<Table<RawAfferent>>,
    motion: Option<Table<RawMotion>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPopulation {
    #[serde(default)]
    seed: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawMotion {
    duration_s: f64,
    #[serde(default)]
    speed_mm_s: f64,
    #[serde(default)]
    direction_deg: f64,
    #[serde(default)]
    turn_deg_s: f64,
    #[serde(default, deserialize_with = "given")]
    frames: Option<u64>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Segment,
    Polyline,
    Disc,
    Dots,
    Braille,
    Grating,
}

impl Kind {
    const ALL: [Self; 6] =
        [Self::Segment, Self::Polyline, Self::Disc, Self::Dots, Self::Braille, Self::Grating];

    const fn word(self) -> &'static str {
        match self {
            Self::Segment => "segment",
            Self::Polyline => "polyline",
            Self::Disc => "disc",
            Self::Dots => "dots",
            Self::Braille => "braille",
            Self::Grating => "grating",
        }
    }
}

/// The key that placed the points of a shape.
enum PlacedBy {
    Points,
    Center,
    /// `character`, whose dots have these numbers.
    Character(Vec<u8>),
}

impl RawTarget {
    fn target(mut self) -> Result<Target, KeyError> {
        let unknown = |unknown| KeyError::key("array", Problem::Array(unknown));
        let array = self
            .array
            .take()
            .map_or_else(|| Ok(Array::paper()), |name| Array::named(&name).map_err(unknown))?;
        let (shape, placed_by) = self.shape(array)?;
        let (duration_s, motion) = match self.motion {
            None => (self.duration_s.unwrap_or(DURATION_S), None),
            Some(_) if self.duration_s.is_some() => {
                return Err(KeyError::key("duration_s", Problem::DurationOfMotion));
            }
            Some(Table(raw)) => {
                let motion = raw.motion(&shape, array.pitch_mm()).map_err(|fault| fault.within("motion"))?;
                (raw.duration_s, Some(motion))
            }
        };
        let frames = match &motion {
            Some(motion) => motion.frames(&shape, duration_s),
            None => vec![Frame { shape: shape.clone(), start_s: None, stop_s: None }],
        };
        let raw = self.afferent.map_or_else(RawAfferent::default, |Table(raw)| raw);
        let target = Target {
            name: self.name,
            array,
            shape,
            reach_mm: self.reach_mm.unwrap_or(REACH_MM),
            amplitude_um: self.amplitude_um.unwrap_or(AMPLITUDE_UM.min(array.motor().travel_um)),
            duration_s,
            population_seed: self.population.map_or(0, |Table(raw)| raw.seed),
            model: raw.model(membrane::POPULATION_NOISE_SD),
            motion,
            frames,
        };
        placed_by.check(&target)?;
        target.checked()
    }

    fn shape(&mut self, array: Array) -> Result<(Shape, PlacedBy), KeyError> {
        self.check_keys()?;
        let missing = |key: &str| {
            KeyError::common(None, key.to_owned(), CommonProblem::Missing { wanted: wanted(key) })
        };
        let number = |key: &str, value: Option<f64>| value.ok_or_else(|| missing(key));
        let Point(center_mm) = self.center_mm.unwrap_or(Point([0.0; 2]));
        match self.shape {
            Kind::Segment | Kind::Polyline | Kind::Dots => {
                let points = self.points.take().ok_or_else(|| missing("points"))?;
                let (least, most, wanted) = match self.shape {
                    Kind::Segment => (2, 2, "the 2 ends of a segment"),
                    Kind::Polyline => (2, MAX_POINTS, "the 2 to 64 points of a polyline"),
                    _ => (1, MAX_POINTS, "1 to 64 dots"),
                };
                let count = points.len();
                if !(least..=most).contains(&count) {
                    return Err(KeyError::key("points", Problem::Count { count, wanted }));
                }
                let points = points.into_iter().map(|Point(at)| at).collect();
                let of = if self.shape == Kind::Dots { Shape::Dots } else { Shape::Polyline };
                Ok((of(points), PlacedBy::Points))
            }
            Kind::Disc => {
                let radius_mm = number("radius_mm", self.radius_mm)?;
                Ok((Shape::Disc { center_mm, radius_mm }, PlacedBy::Center))
            }
            Kind::Braille => {
                let text = self.character.take().ok_or_else(|| missing("character"))?;
                let pitch_mm = self.dot_pitch_mm.unwrap_or(FINEST_PITCHES * array.pitch_mm());
                within("dot_pitch_mm", pitch_mm, &(0.1..=24.0), "0.1 to 24 mm")?;
                let dots = braille_dots(&text, pitch_mm, center_mm)
                    .ok_or_else(|| KeyError::key("character", Problem::Character { found: quote(&text) }))?;
                let (numbers, dots) = dots.into_iter().unzip();
                Ok((Shape::Dots(dots), PlacedBy::Character(numbers)))
            }
            Kind::Grating => {
                let period_mm = number("period_mm", self.period_mm)?;
                let (angle_deg, offset_mm) = (self.angle_deg.unwrap_or(0.0), self.offset_mm.unwrap_or(0.0));
                // Checked here, because frames are made before the rest is checked.
                within("period_mm", period_mm, &(0.1..=1e3), "0.1 to 1000 mm")?;
                // No key places a grating.
                Ok((Shape::Grating { period_mm, angle_deg, offset_mm }, PlacedBy::Points))
            }
        }
    }

    /// Refuses keys of other shapes.
    fn check_keys(&self) -> Result<(), KeyError> {
        use Kind::{Braille, Disc, Dots, Grating, Polyline, Segment};
        let keys = [
            ("points", self.points.is_some(), &[Segment, Polyline, Dots][..], "segment, polyline or dots"),
            ("center_mm", self.center_mm.is_some(), &[Disc, Braille], "disc or braille"),
            ("radius_mm", self.radius_mm.is_some(), &[Disc], "disc"),
            ("character", self.character.is_some(), &[Braille], "braille"),
            ("dot_pitch_mm", self.dot_pitch_mm.is_some(), &[Braille], "braille"),
            ("period_mm", self.period_mm.is_some(), &[Grating], "grating"),
            ("angle_deg", self.angle_deg.is_some(), &[Grating], "grating"),
            ("offset_mm", self.offset_mm.is_some(), &[Grating], "grating"),
        ];
        for (key, there, kinds, of) in keys {
            if there && !kinds.contains(&self.shape) {
                return Err(KeyError::key(key, Problem::Foreign { of, shape: self.shape.word() }));
            }
        }
        Ok(())
    }
}

impl RawMotion {
    fn motion(&self, shape: &Shape, pitch_mm: f64) -> Result<Motion, KeyError> {
        let Self { duration_s, speed_mm_s, direction_deg, turn_deg_s, frames } = *self;
        let mut motion = Motion { speed_mm_s, direction_deg, turn_deg_s, frames: MAX_FRAMES };
        motion.check(duration_s)?;
        motion.frames = match frames {
            None => motion.enough_frames(shape, duration_s, pitch_mm),
            Some(count) => {
                let frames = u8::try_from(count).ok().filter(|frames| (1..=MAX_FRAMES).contains(frames));
                in_range("frames", count as f64, frames.is_some(), "1 to 64")?;
                let enough = u64::from(Motion::most_frames(duration_s)) >= count;
                in_range("frames", count as f64, enough, "so few that each lasts 0.01 s or longer")?;
                frames.unwrap_or(MAX_FRAMES)
            }
        };
        Ok(motion)
    }
}

impl PlacedBy {
    /// Refuses points off the pad, in any frame.
    fn check(&self, target: &Target) -> Result<(), KeyError> {
        for (index, frame) in target.frames.iter().enumerate() {
            let off = frame.shape.points().iter().position(|&at| !on_pad(at));
            let Some(point) = off else { continue };
            let (path, dot) = match self {
                Self::Points => (format!("points[{point}]"), None),
                Self::Center => ("center_mm".to_owned(), None),
                Self::Character(dots) => ("character".to_owned(), Some(dots[point])),
            };
            let (at, frame) = (frame.shape.points()[point], target.frame_number(index));
            return Err(KeyError::key(&path, Problem::OffPad { dot, at, frame }));
        }
        Ok(())
    }
}

impl<'de> Deserialize<'de> for Kind {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        struct Word;
        impl Visitor<'_> for Word {
            type Value = Kind;
            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("the name of a shape, such as \"segment\"")
            }
            fn visit_str<E: Error>(self, found: &str) -> Result<Kind, E> {
                Kind::ALL.into_iter().find(|kind| kind.word() == found).ok_or_else(|| {
                    let words = "segment, polyline, disc, dots, braille or grating";
                    E::custom(format_args!("is {}: must be {words}", quote(found)))
                })
            }
        }
        source.deserialize_str(Word)
    }
}

/// A place, `[x, y]`. Serde's own message about a list of three numbers does not name this form.
#[derive(Clone, Copy)]
struct Point([f64; 2]);

impl<'de> Deserialize<'de> for Point {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        struct Pair;
        impl<'de> Visitor<'de> for Pair {
            type Value = Point;
            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("[x, y], in mm")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Point, A::Error> {
                let (mut found, mut count) = ([0.0; 2], 0);
                for place in &mut found {
                    let Some(number) = list.next_element()? else { break };
                    (*place, count) = (number, count + 1);
                }
                while count >= 2 && list.next_element::<IgnoredAny>()?.is_some() {
                    count += 1;
                }
                match count {
                    2 => Ok(Point(found)),
                    _ => Err(A::Error::custom(format_args!("is a list of {count}: must be [x, y], in mm"))),
                }
            }
        }
        source.deserialize_seq(Pair)
    }
}
