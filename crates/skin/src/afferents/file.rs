//! Reads a scene of the second model, TOML or JSON.
//!
//! Its pins move by a formula (`pins`), or motors move them (`drives`, as in a scene of the first model).
//!
//! Invariant: no key is ignored, except `spikes_s` and `promised_spikes`, the answers of reference scenes.

use super::afferent::Class;
use super::population::{drawn, population};
use super::scene::{PREINDENT_MM, Pins, Scene, SinePin};
use crate::membrane::Position;
use crate::scene::{self, ModelName, Problem, RawPopulation};
use meissner_array::pattern::Drive;
use meissner_input::document::{self, Table};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::sync::Arc;

type KeyError = document::KeyError<Problem>;

/// How long it takes to press the pins in, s (C).
const RAMP_S: f64 = 0.1;
/// When the vibration begins, s (C).
const BEGIN_S: f64 = 0.4;

/// The keys of a file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RawScene {
    #[serde(rename = "model")]
    _model: Option<ModelName>,
    array: Option<String>,
    duration_s: f64,
    #[serde(default)]
    seed: u64,
    preindent_mm: Option<f64>,
    ramp_s: Option<f64>,
    begin_s: Option<f64>,
    noise: Option<bool>,
    pins: Option<Vec<Table<RawPin>>>,
    drives: Option<Vec<Table<Drive>>>,
    // The aliases are the names of the membrane's reference scenes.
    #[serde(alias = "receptors")]
    afferents: Option<Vec<Table<RawAfferent>>>,
    population: Option<Table<RawPopulation>>,
    #[serde(alias = "receptor")]
    afferent: Option<IgnoredAny>,
    #[serde(rename = "spikes_s")]
    _spikes_s: Option<IgnoredAny>,
    #[serde(rename = "promised_spikes")]
    _promised_spikes: Option<IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPin {
    x_mm: f64,
    y_mm: f64,
    frequency_hz: f64,
    amplitude_um: f64,
    #[serde(default)]
    phase: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAfferent {
    class: Option<Class>,
    row: Option<u64>,
    x_mm: f64,
    y_mm: f64,
}

/// A scene from its keys.
pub(crate) fn read(raw: RawScene) -> Result<Scene, KeyError> {
    let own = |problem: Problem| KeyError::whole(None, problem);
    if raw.afferent.is_some() {
        return Err(KeyError::key("afferent", Problem::MembraneKey));
    }
    let array = scene::array(raw.array.as_deref())?;
    let seed = raw.seed;
    let (afferents, by_itself) = match (raw.afferents, raw.population) {
        (Some(afferents), None) => {
            let afferent = |(number, Table(raw)): (usize, Table<RawAfferent>)| {
                let at = Position { x_mm: raw.x_mm, y_mm: raw.y_mm };
                let mut afferent = drawn(seed, number as u64, raw.class.unwrap_or(Class::Ra), at);
                if let Some(row) = raw.row {
                    afferent.row = u8::try_from(row)
                        .ok()
                        .filter(|&row| usize::from(row) < afferent.class.rows())
                        .ok_or_else(|| {
                            let problem = Problem::Row {
                                row,
                                class: afferent.class.name(),
                                most: afferent.class.rows() - 1,
                            };
                            KeyError::key("row", problem).within(&format!("afferents[{number}]"))
                        })?;
                }
                Ok(afferent)
            };
            (afferents.into_iter().enumerate().map(afferent).collect::<Result<_, KeyError>>()?, false)
        }
        (None, Some(Table(of))) => (population(of.seed), true),
        (None, None) => return Err(own(Problem::NoAfferents)),
        (Some(_), Some(_)) => return Err(own(Problem::TwoPopulations)),
    };
    let pins = match (raw.pins, raw.drives) {
        (Some(_), Some(_)) => return Err(own(Problem::PinsAndDrives)),
        (Some(pins), None) => {
            let pin = |Table(raw): Table<RawPin>| {
                let RawPin { x_mm, y_mm, frequency_hz, amplitude_um, phase } = raw;
                SinePin { x_mm, y_mm, frequency_hz, amplitude_um, phase }
            };
            let (ramp_s, begin_s) = (raw.ramp_s.unwrap_or(RAMP_S), raw.begin_s.unwrap_or(BEGIN_S));
            Pins::Sines { pins: pins.into_iter().map(pin).collect(), ramp_s, begin_s }
        }
        (None, drives) => {
            for (key, there) in [("ramp_s", raw.ramp_s.is_some()), ("begin_s", raw.begin_s.is_some())] {
                if there {
                    return Err(KeyError::key(key, Problem::PinsOnly));
                }
            }
            Pins::Drives(drives.unwrap_or_default().into_iter().map(|Table(drive)| drive).collect())
        }
    };
    let scene = Scene {
        array,
        duration_s: raw.duration_s,
        seed: raw.seed,
        preindent_mm: raw.preindent_mm.unwrap_or(PREINDENT_MM),
        noise: raw.noise.unwrap_or(by_itself),
        pins,
        afferents: Arc::new(afferents),
        population: by_itself,
    };
    scene.checked()
}
