//! Reads a scene file of either model, TOML or JSON; both give the same scene.
//!
//! Serde reads JSON without an intermediate tree, because a scene may have a million afferents. The keys of a model are in `scene`
//! and in [`afferents`].
//!
//! Invariant: the argument `model`, else the file's key, decides which keys there are.

use crate::afferents;
use crate::scene::{KeyError, ModelName, Problem, RawScene, Scene, SceneError};
use meissner_array::spec::Array;
use meissner_input::document::{Table, from_json, from_toml};
use serde::Deserialize;

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
    Afferents(afferents::Scene),
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

    /// The array under the finger.
    pub const fn array(&self) -> Array {
        match self {
            Self::Membrane(scene) => scene.array(),
            Self::Afferents(scene) => scene.array(),
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
    let scene = if model == Some(ModelName::Afferents) {
        let Table(raw) = if json { from_json(text, wanted) } else { from_toml(text, wanted) }?;
        afferents::read(raw).map(AnyScene::Afferents)
    } else {
        let Table(raw): Table<RawScene> =
            if json { from_json(text, wanted) } else { from_toml(text, wanted) }?;
        raw.checked_scene().map(AnyScene::Membrane)
    };
    scene.map_err(|fault| if json { fault } else { fault.in_text(text) })
}

fn wanted(key: &str) -> &'static str {
    match key {
        "duration_s" => "how long to simulate, in s",
        "motor" => "the motor's number, from 0 on",
        "frequency_hz" => "a frequency, above 0 and at most half the array's tick rate, Hz",
        "amplitude_um" => "an amplitude, 0 to 1000000 um peak to peak",
        _ => "a place on the skin, in mm from the array's middle",
    }
}
