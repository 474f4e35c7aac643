//! Reading a target file.
//!
//! Which keys there may be depends on the shape, so one that belongs to another shape is refused by hand; so are points
//! off the pad, in the words of the key that placed them. The rest is the target's own check.
//!
//! Invariant: no key is ignored.

use super::error::{KeyError, Problem};
use super::{Frame, MAX_FRAMES, Motion, Shape, Target};
use crate::{braille, shape};
use meissner_input::document::{CommonProblem, Table, from_toml, in_range, line_of};
use meissner_input::message::quote;
use meissner_skin::afferent;
use meissner_skin::{RawAfferent, as_written, one_name};
use serde::de::{Error, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;

/// Bytes of a target file at the most; [`MAX_POINTS`] written out take far less.
pub const MAX_BYTES: usize = 64 << 10;
/// Points of a shape at the most.
pub const MAX_POINTS: usize = 64;

/// Of a Braille cell, mm: two pin pitches.
const DOT_PITCH_MM: f64 = super::FINEST_MM;
const REACH_MM: f64 = 1.5;
/// Where receptors are driven well into their plateau: the paper's.
const AMPLITUDE_UM: f64 = 80.0;
const DURATION_S: f64 = 5.0;

pub(super) fn read(text: &str) -> Result<Target, KeyError> {
    if text.len() > MAX_BYTES {
        return Err(KeyError::whole(None, Problem::TooLarge { bytes: text.len() }));
    }
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let Table(raw): Table<RawTarget> = from_toml(text, wanted)?;
    // What is wrong with a key that is not there is the shape's fault.
    let line = |path: &str| line_of(text, path).or_else(|| line_of(text, "shape"));
    raw.target().map_err(|fault| KeyError { line: fault.line.or_else(|| line(&fault.path)), ..fault })
}

fn wanted(key: &str) -> &'static str {
    match key {
        "name" => "name = \"...\", as the file is called",
        "shape" => "shape = \"segment\", \"polyline\", \"disc\", \"dots\", \"braille\" or \"grating\"",
        "points" => "points = [[x, y], ...], in mm from the array's middle",
        "radius_mm" => "a radius, 0 to 24 mm",
        "character" => "a letter, or a six-dot Braille character",
        "period_mm" => "how far it is from line to line, in mm",
        _ => "how long the motion lasts, in s",
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTarget {
    name: String,
    shape: Kind,
    points: Option<Vec<Point>>,
    center_mm: Option<Point>,
    radius_mm: Option<f64>,
    character: Option<String>,
    dot_pitch_mm: Option<f64>,
    period_mm: Option<f64>,
    angle_deg: Option<f64>,
    offset_mm: Option<f64>,
    reach_mm: Option<f64>,
    amplitude_um: Option<f64>,
    duration_s: Option<f64>,
    population: Option<Table<RawPopulation>>,
    afferent: Option<Table<RawAfferent>>,
    /// Deprecated: the old name of `afferent`.
    receptor: Option<Table<RawAfferent>>,
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

/// Who placed the points of a shape.
enum Placed {
    /// `points[i]`
    Points,
    /// `center_mm`
    Center,
    /// A character's dots of these numbers.
    Character(Vec<u8>),
}

impl RawTarget {
    fn target(mut self) -> Result<Target, KeyError> {
        let (shape, placed) = self.shape()?;
        let (duration_s, motion) = match self.motion {
            None => (self.duration_s.unwrap_or(DURATION_S), None),
            Some(_) if self.duration_s.is_some() => {
                return Err(KeyError::key("duration_s", Problem::DurationOfMotion));
            }
            Some(Table(raw)) => {
                let motion = raw.motion(&shape).map_err(|fault| fault.within("motion"))?;
                (raw.duration_s, Some(motion))
            }
        };
        let frames = match &motion {
            Some(motion) => motion.frames(&shape, duration_s),
            None => vec![Frame { shape: shape.clone(), start_s: None, stop_s: None }],
        };
        let (raw, written) = one_name(("afferent", self.afferent), ("receptor", self.receptor))
            .map_err(|two| KeyError::whole(None, two.into()))?;
        let raw = raw.map_or_else(RawAfferent::default, |Table(raw)| raw);
        let target = Target {
            name: self.name,
            shape,
            reach_mm: self.reach_mm.unwrap_or(REACH_MM),
            amplitude_um: self.amplitude_um.unwrap_or(AMPLITUDE_UM),
            duration_s,
            population_seed: self.population.map_or(0, |Table(raw)| raw.seed),
            model: raw.model(afferent::POPULATION_NOISE_SD),
            motion,
            frames,
        };
        placed.check(&target)?;
        target.checked().map_err(|fault| as_written(fault, "afferent", written))
    }

    fn shape(&mut self) -> Result<(Shape, Placed), KeyError> {
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
                Ok((of(points), Placed::Points))
            }
            Kind::Disc => {
                let radius_mm = number("radius_mm", self.radius_mm)?;
                Ok((Shape::Disc { center_mm, radius_mm }, Placed::Center))
            }
            Kind::Braille => {
                let text = self.character.take().ok_or_else(|| missing("character"))?;
                let pitch_mm = self.dot_pitch_mm.unwrap_or(DOT_PITCH_MM);
                in_range("dot_pitch_mm", pitch_mm, (0.1..=24.0).contains(&pitch_mm), "0.1 to 24 mm")?;
                let dots = braille::dots(&text, pitch_mm, center_mm)
                    .ok_or_else(|| KeyError::key("character", Problem::Character { found: quote(&text) }))?;
                let (numbers, dots) = dots.into_iter().unzip();
                Ok((Shape::Dots(dots), Placed::Character(numbers)))
            }
            Kind::Grating => {
                let period_mm = number("period_mm", self.period_mm)?;
                let (angle_deg, offset_mm) = (self.angle_deg.unwrap_or(0.0), self.offset_mm.unwrap_or(0.0));
                // Frames are made before the rest is checked: lines must have a distance.
                in_range("period_mm", period_mm, (0.1..=1e3).contains(&period_mm), "0.1 to 1000 mm")?;
                // Nothing places a grating: it is everywhere.
                Ok((Shape::Grating { period_mm, angle_deg, offset_mm }, Placed::Points))
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
    fn motion(&self, shape: &Shape) -> Result<Motion, KeyError> {
        let Self { duration_s, speed_mm_s, direction_deg, turn_deg_s, frames } = *self;
        let mut motion = Motion { speed_mm_s, direction_deg, turn_deg_s, frames: MAX_FRAMES };
        motion.check(duration_s)?;
        motion.frames = match frames {
            None => motion.enough_frames(shape, duration_s),
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

impl Placed {
    /// Whether all points lie on the pad, in every frame.
    fn check(&self, target: &Target) -> Result<(), KeyError> {
        for (index, frame) in target.frames.iter().enumerate() {
            let off = frame.shape.points().iter().position(|&at| !shape::on_pad(at));
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
                text.write_str("the name of a shape, as \"segment\"")
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

/// A place as `[x, y]`. What serde derives for an array would not say what is wrong with a list of three.
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
