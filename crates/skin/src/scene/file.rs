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
use meissner_input::document::{Table, in_range};
use serde::de::{Error, IgnoredAny, Unexpected, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
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
    drives: Vec<Table<RawDrive>>,
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
pub(crate) struct RawDrive {
    #[serde(deserialize_with = "whole")]
    motor: f64,
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

/// The array that a scene names, or the paper's.
pub(crate) fn array(name: Option<&str>) -> Result<Array, KeyError> {
    let unknown = |unknown| KeyError::key("array", Problem::Array(unknown));
    name.map_or_else(|| Ok(Array::paper()), |name| Array::named(name).map_err(unknown))
}

/// The drives of motors of an array.
pub(crate) fn drives(array: Array, raw: Vec<Table<RawDrive>>) -> Result<Vec<Drive>, KeyError> {
    let drive = |(index, Table(raw)): (usize, Table<RawDrive>)| {
        let RawDrive { motor, frequency_hz, amplitude_um, phase, start_s, stop_s } = raw;
        let good = (0.0..array.motors() as f64).contains(&motor);
        in_range("motor", motor, good, array.motor_range())
            .map_err(|fault| fault.within(&format!("drives[{index}]")))?;
        Ok(Drive { motor: motor as u8, frequency_hz, amplitude_um, phase, start_s, stop_s })
    };
    raw.into_iter().enumerate().map(drive).collect()
}

impl RawScene {
    /// The scene of these keys. `placed` adds the line to a problem with a key that names an array or a motor.
    pub(crate) fn checked_scene(self, placed: impl Fn(KeyError) -> KeyError) -> Result<Scene, KeyError> {
        let own = |problem: Problem| KeyError::whole(None, problem);
        let (afferents, noise_sd) = match (self.afferents, self.population) {
            // This collects in place, so memory holds only one copy of a million afferents.
            (Some(afferents), None) => (afferents.into_iter().map(|Table(at)| at).collect(), 0.0),
            (None, Some(Table(of))) => (membrane::population(of.seed), membrane::POPULATION_NOISE_SD),
            (None, None) => return Err(own(Problem::NoAfferents)),
            (Some(_), Some(_)) => return Err(own(Problem::TwoPopulations)),
        };
        let array = array(self.array.as_deref()).map_err(&placed)?;
        let scene = Scene {
            array,
            duration_s: self.duration_s,
            seed: self.seed,
            drives: drives(array, self.drives).map_err(&placed)?,
            afferents: Arc::new(afferents),
            gains: ideal(array),
            model: self.afferent.map_or_else(RawAfferent::default, |Table(raw)| raw).model(noise_sd),
        };
        scene.checked()
    }
}

/// Reads a motor's number. It takes a whole number of any size, so that all that are too large are refused with the same words.
fn whole<'de, D: Deserializer<'de>>(source: D) -> Result<f64, D::Error> {
    struct Whole;
    impl Visitor<'_> for Whole {
        type Value = f64;
        fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
            text.write_str("a whole number, from 0 on")
        }
        fn visit_u64<E: Error>(self, found: u64) -> Result<f64, E> {
            Ok(found as f64)
        }
        fn visit_i64<E: Error>(self, found: i64) -> Result<f64, E> {
            Ok(found as f64)
        }
        fn visit_u128<E: Error>(self, found: u128) -> Result<f64, E> {
            Ok(found as f64)
        }
        fn visit_i128<E: Error>(self, found: i128) -> Result<f64, E> {
            Ok(found as f64)
        }
        /// For JSON's whole numbers beyond 64 bits.
        fn visit_f64<E: Error>(self, found: f64) -> Result<f64, E> {
            match found.abs() >= 9e18 && found.is_finite() {
                true => Ok(found),
                false => Err(E::invalid_type(Unexpected::Float(found), &self)),
            }
        }
    }
    source.deserialize_any(Whole)
}
