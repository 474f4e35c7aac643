//! The keys of a membrane's scene file. The scene's own check, which built scenes use, too, refuses a value of the right type that
//! is out of range.
//!
//! Invariant: no key is ignored, except `spikes_s` and `promised_spikes`, the answers of reference scenes.

use super::afferent::RawAfferent;
use super::checked::{MOTOR_RANGE, NO_GAINS, Scene};
use super::error::{KeyError, Problem};
use super::names::{ModelName, as_written, one_name};
use crate::membrane::{self, Position};
use firmware_protocol::stroke::MOTORS;
use meissner_array::pattern::Drive;
use meissner_input::document::Table;
use meissner_input::message::short_number;
use serde::de::{Error, IgnoredAny, Unexpected, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::sync::Arc;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawScene {
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
    /// The scene of these keys.
    pub(crate) fn checked_scene(self) -> Result<Scene, KeyError> {
        let own = |problem: Problem| KeyError::whole(None, problem);
        let (afferents, list) = one_name(("afferents", self.afferents), ("receptors", self.receptors))
            .map_err(|two| own(two.into()))?;
        let (afferent, table) = one_name(("afferent", self.afferent), ("receptor", self.receptor))
            .map_err(|two| own(two.into()))?;
        let (afferents, noise_sd) = match (afferents, self.population) {
            // This collects in place, so memory holds only one copy of a million afferents.
            (Some(afferents), None) => (afferents.into_iter().map(|Table(at)| at).collect(), 0.0),
            (None, Some(Table(of))) => (membrane::population(of.seed), membrane::POPULATION_NOISE_SD),
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
