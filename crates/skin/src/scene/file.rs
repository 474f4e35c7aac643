//! Reads a scene file, TOML or JSON; both give the same scene.
//!
//! Serde reads JSON without an intermediate tree, because a scene may have a million afferents. The scene's own check, which built
//! scenes use, too, refuses a value of the right type that is out of range.
//!
//! Invariant: no key is ignored, except `spikes_s` and `promised_spikes`, the answers of reference scenes.

use super::afferent::RawAfferent;
use super::checked::{MOTOR_RANGE, NO_GAINS, Scene};
use super::error::{KeyError, Problem, SceneError};
use super::names::{ModelName, as_written, one_name};
use crate::afferent::{self, Position};
use crate::fingertip;
use firmware_protocol::stroke::MOTORS;
use meissner_array::pattern::Drive;
use meissner_input::document::{Table, from_json, from_toml};
use meissner_input::message::short_number;
use serde::de::{Error, IgnoredAny, Unexpected, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::sync::Arc;

/// The most bytes of a JSON scene: some millions of afferents, of which memory holds one copy, without their text.
pub const MAX_JSON_BYTES: usize = 256 << 20;
/// The most bytes of a TOML scene. Its parser holds the whole tree: 45 times the file for a list of afferents, and up to
/// 240 times for a hostile file (measured).
pub const MAX_TOML_BYTES: usize = 16 << 20;

impl Scene {
    /// Reads a scene file; `file` is its name in errors. The ending `.json` or `.toml` decides the format; without one, a
    /// text that begins with a brace is JSON.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str) -> Result<Self, SceneError> {
        match AnyScene::read(text, file, None)? {
            AnyScene::Membrane(scene) => Ok(scene),
            AnyScene::Afferents(_) => Err(KeyError::key("model", Problem::MembraneOnly).in_file(Some(file))),
        }
    }
}

/// A scene of either model.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is one per simulation")]
pub enum AnyScene {
    /// A scene of the first model: RA afferents with a leaky membrane.
    Membrane(Scene),
    /// A scene of the second model: skin mechanics, and SA1, RA and PC afferents.
    Afferents(fingertip::Scene),
}

impl AnyScene {
    /// Reads a scene file of either model, as [`Scene::read`] does. The argument `model` decides, else the file's key `model`;
    /// without both it is the membrane.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str, model: Option<ModelName>) -> Result<Self, SceneError> {
        read(text, file, model).map_err(|fault| fault.in_file(Some(file)))
    }

    /// Duration, s.
    #[must_use]
    pub const fn duration_s(&self) -> f64 {
        match self {
            Self::Membrane(scene) => scene.duration_s(),
            Self::Afferents(scene) => scene.duration_s(),
        }
    }
}

/// The key that decides how to read the others.
#[derive(Deserialize)]
struct OfModel {
    model: Option<ModelName>,
}

fn read(text: &str, file: &str, model: Option<ModelName>) -> Result<AnyScene, KeyError> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let ends_in =
        |ending| std::path::Path::new(file).extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    let json = ends_in("json") || (!ends_in("toml") && text.trim_start().starts_with('{'));
    let (language, most, advice) = match json {
        true => ("JSON", MAX_JSON_BYTES, ""),
        false => ("TOML", MAX_TOML_BYTES, "; write it as JSON, which may have more"),
    };
    if text.len() > most {
        return Err(KeyError::whole(None, Problem::TooLarge { bytes: text.len(), language, most, advice }));
    }
    let of_file = || -> Result<_, KeyError> {
        // Most scenes do not name a model, and reading a million afferents twice takes long.
        if !text.contains("model") {
            return Ok(None);
        }
        let Table(OfModel { model }) = if json { from_json(text, wanted) } else { from_toml(text, wanted) }?;
        Ok(model)
    };
    let model = model.map_or_else(of_file, |model| Ok(Some(model)))?;
    if model == Some(ModelName::Afferents) {
        let Table(raw) = if json { from_json(text, wanted) } else { from_toml(text, wanted) }?;
        let scene = fingertip::read(raw).map_err(|fault| if json { fault } else { fault.in_text(text) })?;
        return Ok(AnyScene::Afferents(scene));
    }
    let Table(raw): Table<RawScene> = if json { from_json(text, wanted) } else { from_toml(text, wanted) }?;
    raw.checked_scene().map(AnyScene::Membrane)
}

fn wanted(key: &str) -> &'static str {
    match key {
        "duration_s" => "how long to simulate, in s",
        "motor" => "the motor's number, 0 to 23",
        "frequency_hz" => "a frequency, above 0 and at most 42500 Hz",
        "amplitude_um" => "an amplitude, 0 to 1000000 um peak to peak",
        _ => "a place on the skin, in mm from the array's middle",
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawScene {
    #[serde(rename = "model")]
    _model: Option<ModelName>,
    duration_s: f64,
    #[serde(default)]
    seed: u64,
    #[serde(default)]
    drives: Vec<Table<RawDrive>>,
    afferents: Option<Vec<Table<Position>>>,
    /// Deprecated: the old name of `afferents`.
    receptors: Option<Vec<Table<Position>>>,
    population: Option<Table<RawPopulation>>,
    afferent: Option<Table<RawAfferent>>,
    /// Deprecated: the old name of `afferent`.
    receptor: Option<Table<RawAfferent>>,
    #[serde(rename = "spikes_s")]
    _spikes_s: Option<IgnoredAny>,
    #[serde(rename = "promised_spikes")]
    _promised_spikes: Option<IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawDrive {
    #[serde(deserialize_with = "motor")]
    motor: u8,
    frequency_hz: f64,
    amplitude_um: f64,
    #[serde(default)]
    phase: f64,
    start_s: Option<f64>,
    stop_s: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawPopulation {
    #[serde(default)]
    pub(crate) seed: u64,
}

impl From<RawDrive> for Drive {
    fn from(raw: RawDrive) -> Self {
        let RawDrive { motor, frequency_hz, amplitude_um, phase, start_s, stop_s } = raw;
        Self { motor, frequency_hz, amplitude_um, phase, start_s, stop_s }
    }
}

impl RawScene {
    fn checked_scene(self) -> Result<Scene, KeyError> {
        let own = |problem: Problem| KeyError::whole(None, problem);
        let (afferents, list) = one_name(("afferents", self.afferents), ("receptors", self.receptors))
            .map_err(|two| own(two.into()))?;
        let (afferent, table) = one_name(("afferent", self.afferent), ("receptor", self.receptor))
            .map_err(|two| own(two.into()))?;
        let (afferents, noise_sd) = match (afferents, self.population) {
            // This collects in place, so memory holds only one copy of a million afferents.
            (Some(afferents), None) => (afferents.into_iter().map(|Table(at)| at).collect(), 0.0),
            (None, Some(Table(of))) => (afferent::population(of.seed), afferent::POPULATION_NOISE_SD),
            (None, None) => return Err(own(Problem::NoAfferents)),
            (Some(_), Some(_)) => return Err(own(Problem::TwoPopulations { afferents: list })),
        };
        let scene = Scene {
            duration_s: self.duration_s,
            seed: self.seed,
            drives: self.drives.into_iter().map(|Table(raw)| raw.into()).collect(),
            afferents: Arc::new(afferents),
            gains: NO_GAINS,
            model: afferent.map_or_else(RawAfferent::default, |Table(raw)| raw).model(noise_sd),
        };
        let written = |fault| as_written(as_written(fault, "afferents", list), "afferent", table);
        scene.checked().map_err(written)
    }
}

/// Reads a motor's number. It takes a whole number of any size, to refuse 24 and 300 with the same words.
fn motor<'de, D: Deserializer<'de>>(source: D) -> Result<u8, D::Error> {
    struct Whole;
    fn number<E: Error>(found: Option<u8>, shown: &dyn fmt::Display) -> Result<u8, E> {
        let motor = found.filter(|&motor| usize::from(motor) < MOTORS);
        motor.ok_or_else(|| E::custom(format_args!("is {shown}: must be {MOTOR_RANGE}")))
    }
    impl Visitor<'_> for Whole {
        type Value = u8;
        fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(text, "a whole number, {MOTOR_RANGE}")
        }
        fn visit_u64<E: Error>(self, found: u64) -> Result<u8, E> {
            number(found.try_into().ok(), &found)
        }
        fn visit_i64<E: Error>(self, found: i64) -> Result<u8, E> {
            number(found.try_into().ok(), &found)
        }
        fn visit_u128<E: Error>(self, found: u128) -> Result<u8, E> {
            number(found.try_into().ok(), &found)
        }
        fn visit_i128<E: Error>(self, found: i128) -> Result<u8, E> {
            number(found.try_into().ok(), &found)
        }
        /// For JSON's whole numbers beyond 64 bits.
        fn visit_f64<E: Error>(self, found: f64) -> Result<u8, E> {
            match found.abs() >= 9e18 && found.is_finite() {
                true => number(None, &short_number(found)),
                false => Err(E::invalid_type(Unexpected::Float(found), &self)),
            }
        }
    }
    source.deserialize_any(Whole)
}
