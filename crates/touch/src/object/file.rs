//! Reads object files: the keys that all shapes have, and the touch. `shapes` reads those of the shape.
//!
//! Errors name the key. Keys that only a search for a pattern needs are known here, and `meissner-paper` reads them.
//!
//! Invariant: no key is unknown.

use super::Object;
use super::error::{KeyError, MAX_FILE_BYTES, ObjectError, Problem};
use super::shapes::{self, Keys, Row, SHAPES};
use super::source::{Numbers, Open, Source, bytes_of, check_places, missing, no_files, numbers};
use crate::shape::Shape;
use crate::touch::{MAX_DEPTH_MM, Pose, Press, Scan, Touch};
use meissner_array::samples::read_columns;
use meissner_input::document::{CommonProblem, Table, given, in_range, keys_of};
use meissner_input::message::{nearest, quote};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::BTreeMap;

/// Defaults of a touch, s.
const RISE_S: f64 = 0.05;
const HOLD_S: f64 = 0.2;
/// The keys of a search. The dots of a Braille character stand two pitches of its array apart.
const OF_SEARCH: [&str; 8] =
    ["array", "reach_mm", "amplitude_um", "duration_s", "population", "afferent", "receptor", "motion"];

impl Object {
    /// Reads an object file. Errors call it `file`; `open` gives the files that it names.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str, open: Open<'_>) -> Result<Self, ObjectError> {
        read(&Source::Toml(text))
            .and_then(|(raw, keys)| raw.object(&*keys, open))
            .map_err(|fault: KeyError| fault.in_text(text).in_file(Some(file)))
    }

    /// Reads the same keys as JSON; `open` gives the files that they name.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read_json(text: &str, open: Open<'_>) -> Result<Self, ObjectError> {
        read(&Source::Json(text))
            .and_then(|(raw, keys)| raw.object(&*keys, open))
            .map_err(|fault: KeyError| fault.in_file(None))
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
        let (raw, keys) = read(&Source::Toml(text))?;
        raw.drawn(&*keys)
    }
}

fn read(source: &Source<'_>) -> Result<(RawObject, Box<dyn Keys>), KeyError> {
    let bytes = source.text().len();
    if bytes > MAX_FILE_BYTES {
        return Err(KeyError::whole(None, Problem::TooLarge { bytes }));
    }
    let raw: RawObject = source.read(wanted)?;
    raw.check(source)?;
    let keys = (raw.shape.read)(source)?;
    Ok((raw, keys))
}

fn wanted(key: &str) -> &'static str {
    match key {
        "name" => "name = \"...\", the name of the file",
        "shape" => &shapes::WANTED,
        "touch" => "[touch] with press = { depth_um = 500 }, a scan or a path",
        "depth_um" => "the depth, um",
        _ => "the speed, mm/s",
    }
}

/// The keys that all shapes have.
#[derive(Deserialize)]
struct RawObject {
    kind: Option<String>,
    name: String,
    #[serde(deserialize_with = "shapes::named")]
    shape: &'static Row,
    #[serde(default, deserialize_with = "numbers")]
    center_mm: [f64; 2],
    #[serde(default)]
    angle_deg: f64,
    touch: Option<Table<RawTouch>>,
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

impl RawObject {
    /// Checks what all shapes have.
    fn check(&self, source: &Source<'_>) -> Result<(), KeyError> {
        if let Some(kind) = self.kind.as_deref().filter(|kind| *kind != "object") {
            return Err(KeyError::key("kind", Problem::Kind { found: quote(kind) }));
        }
        let is_named = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if !(1..=64).contains(&self.name.len()) || !self.name.chars().all(is_named) {
            return Err(KeyError::key("name", Problem::Name { found: quote(&self.name) }));
        }
        let all: BTreeMap<String, IgnoredAny> = source.read(wanted)?;
        all.keys().try_for_each(|key| self.check_key(key, source))?;
        check_places("center_mm", [self.center_mm].iter())?;
        in_range("angle_deg", self.angle_deg, self.angle_deg.abs() <= 360.0, "-360 to 360 degrees")
    }

    /// Refuses an unknown key, and one of other shapes.
    fn check_key(&self, key: &str, source: &Source<'_>) -> Result<(), KeyError> {
        let common = [keys_of::<Self>(), &OF_SEARCH].concat();
        if common.contains(&key) || self.shape.has(key) {
            return Ok(());
        }
        let of = shapes::names(|row| row.has(key), "");
        if of.is_empty() {
            let known = SHAPES.iter().map(|row| (row.keys)()).chain([&*common]).collect::<Vec<_>>().concat();
            let unknown =
                CommonProblem::UnknownKey { key: quote(key), nearest: nearest(&known, key).to_owned() };
            return Err(KeyError::common(source.line_of(key), String::new(), unknown));
        }
        Err(KeyError::key(key, Problem::Foreign { of, shape: self.shape.name }))
    }

    /// What a search takes of it.
    fn drawn(self, keys: &dyn Keys) -> Result<Drawn, KeyError> {
        let not_drawn = || {
            let wanted = shapes::names(|row| row.is_drawn, "");
            KeyError::key("shape", Problem::NotDrawn { shape: self.shape.name, wanted })
        };
        let mut has_file = false;
        let surface = keys.surface(&mut |name| {
            has_file = true;
            no_files(name)
        });
        if has_file {
            return Err(not_drawn());
        }
        let shape = keys.drawn(surface?, self.center_mm, self.angle_deg).ok_or_else(not_drawn)?;
        let touch = self.touch.as_ref().map(|Table(touch)| touch);
        let scan = touch.and_then(|touch| touch.scan.as_ref()).map(|Table(scan)| scan.scan());
        let scan = scan.transpose().map_err(|fault| fault.within("touch.scan"))?;
        let has_path = touch.is_some_and(|touch| touch.path.is_some());
        Ok(Drawn { shape, placed_by: keys.placed_by(), scan, has_path, name: self.name })
    }

    fn object(self, keys: &dyn Keys, open: Open<'_>) -> Result<Object, KeyError> {
        let surface = keys.surface(open)?;
        let [x_mm, y_mm] = self.center_mm;
        let at = Pose { x_mm, y_mm, angle_deg: self.angle_deg, depth_mm: 0.0 };
        let Table(touch) = self.touch.ok_or_else(|| missing("touch", wanted))?;
        let touch = touch.touch(at, open).map_err(|fault| fault.within("touch"))?;
        Ok(Object { name: self.name, surface, touch })
    }
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
