//! Reads what a search needs of an object file, and writes it.
//!
//! `meissner-touch` reads the shape and refuses unknown keys; this module reads the keys of a search. It refuses a point off the pad;
//! the error names the key that placed it. [`Target::checked`] checks the rest.

use crate::target::checked::Target;
use crate::target::error::{KeyError, Problem, TargetError};
use crate::target::limits::{MAX_FRAMES, MAX_POINTS};
use crate::target::motion::{Frame, Motion};
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_input::document::{self, Table, from_toml, given, in_range, line_of};
use meissner_skin::RawAfferent;
use meissner_skin::membrane;
use meissner_touch::{Drawn, Scan, Shape, on_pad};
use serde::Deserialize;
use toml::Value;

/// The key of a pattern's provenance under which it keeps its target.
pub(crate) const DEFINITION: &str = "definition";

/// Defaults. The amplitude is the paper's; it drives afferents well into their plateau. Motors with less travel have that.
const REACH_MM: f64 = 1.5;
const AMPLITUDE_UM: f64 = 80.0;
const DURATION_S: f64 = 5.0;

impl Target {
    /// Reads an object file. Errors call it `file`.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str) -> Result<Self, TargetError> {
        read(text).map_err(|fault: KeyError| {
            let fault = fault.in_text(text);
            // A missing key has no line: the error then names the line of the shape.
            let line = fault.line.or_else(|| line_of(text, "shape"));
            KeyError { line, ..fault }.in_file(Some(file))
        })
    }

    /// The target that a pattern was made for, on the pattern's array, if its provenance holds one that can be read.
    pub fn made_for(pattern: &Pattern) -> Option<Self> {
        let text = toml::to_string(pattern.provenance().get(DEFINITION)?.as_table()?).ok()?;
        let target = Self::read(&text, DEFINITION).ok()?;
        if target.array == pattern.array() { Some(target) } else { target.with_array(pattern.array()).ok() }
    }

    /// The target as a table with every key. [`Self::read`] makes an equal target of it: a polyline of two points is
    /// written as a segment, a Braille character as its dots.
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

fn read(text: &str) -> Result<Target, KeyError> {
    let drawn = Drawn::read(text).map_err(|fault| KeyError {
        line: fault.line,
        path: fault.path,
        problem: match fault.problem {
            document::Problem::Common(problem) => document::Problem::Common(problem),
            document::Problem::Own(problem) => document::Problem::Own(problem.into()),
        },
    })?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let Table(raw): Table<RawTarget> = from_toml(text, |_| "the duration of the motion, in s")?;
    raw.target(drawn)
}

/// The keys of a search. Unknown ones were refused before.
#[derive(Deserialize)]
struct RawTarget {
    array: Option<String>,
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

impl RawTarget {
    fn target(self, drawn: Drawn) -> Result<Target, KeyError> {
        let unknown = |unknown| KeyError::key("array", Problem::Array(unknown));
        let array =
            self.array.map_or_else(|| Ok(Array::paper()), |name| Array::named(&name).map_err(unknown))?;
        let Drawn { name, shape, placed_by, scan, has_path } = drawn;
        let count = shape.points().len();
        if count > MAX_POINTS {
            return Err(KeyError::key(placed_by, Problem::Count { count }));
        }
        let of = if self.motion.is_some() { "motion" } else { "touch.scan" };
        let of_scan = |scan: Scan| Table(RawMotion::of(scan));
        let (duration_s, motion) = match self.motion.or(scan.map(of_scan)) {
            None if has_path => return Err(KeyError::key("touch", Problem::Path)),
            None => (self.duration_s.unwrap_or(DURATION_S), None),
            Some(_) if self.duration_s.is_some() => {
                return Err(KeyError::key("duration_s", Problem::DurationOfMotion { of }));
            }
            Some(Table(raw)) => {
                let motion = raw.motion(&shape, array.pitch_mm()).map_err(|fault| fault.within(of))?;
                (raw.duration_s, Some(motion))
            }
        };
        let frames = match &motion {
            Some(motion) => motion.frames(&shape, duration_s),
            None => vec![Frame { shape: shape.clone(), start_s: None, stop_s: None }],
        };
        let raw = self.afferent.map_or_else(RawAfferent::default, |Table(raw)| raw);
        let target = Target {
            name,
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
        check_points(&target, placed_by)?;
        target.checked()
    }
}

impl RawMotion {
    const fn of(Scan { speed_mm_s, direction_deg, duration_s, .. }: Scan) -> Self {
        Self { duration_s, speed_mm_s, direction_deg, turn_deg_s: 0.0, frames: None }
    }

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

/// Refuses points off the pad, in any frame.
fn check_points(target: &Target, placed_by: &str) -> Result<(), KeyError> {
    for (index, frame) in target.frames.iter().enumerate() {
        if let Some(&at) = frame.shape.points().iter().find(|&&at| !on_pad(at)) {
            let frame = target.frame_number(index);
            return Err(KeyError::key(placed_by, Problem::OffPad { at, frame }));
        }
    }
    Ok(())
}
