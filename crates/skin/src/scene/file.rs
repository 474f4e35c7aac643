//! The keys of a membrane's scene file. The scene's own check, which built scenes use, too, refuses a value of the right type that
//! is out of range.
//!
//! Invariant: no key is ignored, except `spikes_s` and `promised_spikes`, the answers of reference scenes.

use super::afferent::RawAfferent;
use super::checked::{Scene, ideal};
use super::error::{KeyError, Problem};
use super::names::ModelName;
use crate::membrane::{self, Position};
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_input::document::Table;
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::sync::Arc;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawScene {
    #[serde(rename = "model")]
    _model: Option<ModelName>,
    array: Option<String>,
    duration_s: f64,
    #[serde(default)]
    seed: u64,
    #[serde(default)]
    drives: Vec<Table<Drive>>,
    // The aliases are the names of the reference scenes.
    #[serde(alias = "receptors")]
    afferents: Option<Vec<Table<Position>>>,
    population: Option<Table<RawPopulation>>,
    #[serde(alias = "receptor")]
    afferent: Option<Table<RawAfferent>>,
    #[serde(rename = "spikes_s")]
    _spikes_s: Option<IgnoredAny>,
    #[serde(rename = "promised_spikes")]
    _promised_spikes: Option<IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawPopulation {
    #[serde(default)]
    pub(crate) seed: u64,
}

/// The array that a scene names, or the paper's.
pub(crate) fn array(name: Option<&str>) -> Result<Array, KeyError> {
    let unknown = |unknown| KeyError::key("array", Problem::Array(unknown));
    name.map_or_else(|| Ok(Array::paper()), |name| Array::named(name).map_err(unknown))
}

impl RawScene {
    /// The scene of these keys.
    pub(crate) fn checked_scene(self) -> Result<Scene, KeyError> {
        let own = |problem: Problem| KeyError::whole(None, problem);
        let (afferents, noise_sd) = match (self.afferents, self.population) {
            // This collects in place, so memory holds only one copy of a million afferents.
            (Some(afferents), None) => (afferents.into_iter().map(|Table(at)| at).collect(), 0.0),
            (None, Some(Table(of))) => (membrane::population(of.seed), membrane::POPULATION_NOISE_SD),
            (None, None) => return Err(own(Problem::NoAfferents)),
            (Some(_), Some(_)) => return Err(own(Problem::TwoPopulations)),
        };
        let array = array(self.array.as_deref())?;
        let scene = Scene {
            array,
            duration_s: self.duration_s,
            seed: self.seed,
            drives: self.drives.into_iter().map(|Table(drive)| drive).collect(),
            afferents: Arc::new(afferents),
            gains: ideal(array),
            model: self.afferent.map_or_else(RawAfferent::default, |Table(raw)| raw).model(noise_sd),
        };
        scene.checked()
    }
}
