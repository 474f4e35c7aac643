//! Reading a scene file, TOML or JSON, into one and the same scene.
//!
//! Serde reads what may be a million receptors without a tree in between (JSON), through `keyed`. What is within a type but out of range is not refused here but by
//! the scene's own check, which serves built scenes too.
//!
//! Invariant: no key is ignored but `spikes_s` and `promised_spikes`, with which reference scenes tell their answers.

use super::error::{Fault, Problem};
use super::{MOTOR_RANGE, NO_GAINS, RawReceptor, Scene};
use crate::afferent::{self, Position};
use firmware_protocol::stroke::MOTORS;
use meissner_array::pattern::Drive;
use meissner_input::document::{Keyed, from_json, from_toml};
use meissner_input::message::figure;
use serde::de::{Error, IgnoredAny, Unexpected, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::sync::Arc;

/// Bytes of a JSON scene at the most: some millions of receptors, which are held once and without their text.
pub const MAX_JSON_BYTES: usize = 256 << 20;
/// Bytes of a TOML scene at the most. Its parser holds the whole tree: 45 times the file where it lists receptors, as
/// much as 240 times where somebody means ill (measured).
pub const MAX_TOML_BYTES: usize = 16 << 20;

pub(super) fn read(text: &str, file: &str) -> Result<Scene, Fault> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let ends_in =
        |ending| std::path::Path::new(file).extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    let json = ends_in("json") || (!ends_in("toml") && text.trim_start().starts_with('{'));
    let (language, most, advice) = match json {
        true => ("JSON", MAX_JSON_BYTES, ""),
        false => ("TOML", MAX_TOML_BYTES, "; write it as JSON, which may have more"),
    };
    if text.len() > most {
        return Err(Fault::whole(None, Problem::TooLarge { bytes: text.len(), language, most, advice }));
    }
    let Keyed(raw): Keyed<RawScene> = if json { from_json(text, wanted) } else { from_toml(text, wanted) }?;
    raw.scene()
}

fn wanted(key: &str) -> &'static str {
    match key {
        "duration_s" => "how long to watch, in s",
        "motor" => "the motor's number, 0 to 23",
        "frequency_hz" => "a frequency, above 0 and at most 42500 Hz",
        "amplitude_um" => "an amplitude, 0 to 1000000 um peak to peak",
        _ => "a place on the skin, in mm from the array's middle",
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawScene {
    duration_s: f64,
    #[serde(default)]
    seed: u64,
    #[serde(default)]
    drives: Vec<Keyed<RawDrive>>,
    receptors: Option<Vec<Keyed<Position>>>,
    population: Option<Keyed<RawPopulation>>,
    receptor: Option<Keyed<RawReceptor>>,
    #[serde(rename = "spikes_s")]
    _spikes_s: Option<IgnoredAny>,
    #[serde(rename = "promised_spikes")]
    _promised_spikes: Option<IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDrive {
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
struct RawPopulation {
    #[serde(default)]
    seed: u64,
}

impl RawScene {
    fn scene(self) -> Result<Scene, Fault> {
        let (receptors, noise_sd) = match (self.receptors, self.population) {
            // In place: a million of them are held once.
            (Some(receptors), None) => (receptors.into_iter().map(|Keyed(at)| at).collect(), 0.0),
            (None, Some(Keyed(of))) => (afferent::population(of.seed), afferent::POPULATION_NOISE_SD),
            (None, None) => return Err(Fault::whole(None, Problem::NoReceptors)),
            (Some(_), Some(_)) => return Err(Fault::whole(None, Problem::TwoPopulations)),
        };
        let drive = |Keyed(raw): Keyed<RawDrive>| {
            let RawDrive { motor, frequency_hz, amplitude_um, phase, start_s, stop_s } = raw;
            Drive { motor, frequency_hz, amplitude_um, phase, start_s, stop_s }
        };
        Ok(Scene {
            duration_s: self.duration_s,
            seed: self.seed,
            drives: self.drives.into_iter().map(drive).collect(),
            receptors: Arc::new(receptors),
            gains: NO_GAINS,
            model: self.receptor.map_or_else(RawReceptor::default, |Keyed(raw)| raw).model(noise_sd),
        })
    }
}

/// A whole number of any size, so that 24 and 300 are refused with the same words.
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
        /// JSON's whole numbers beyond 64 bits come this way.
        fn visit_f64<E: Error>(self, found: f64) -> Result<u8, E> {
            match found.abs() >= 9e18 && found.is_finite() {
                true => number(None, &figure(found)),
                false => Err(E::invalid_type(Unexpected::Float(found), &self)),
            }
        }
    }
    source.deserialize_any(Whole)
}
