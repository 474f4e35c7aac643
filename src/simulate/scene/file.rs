//! Reading a scene file, TOML or JSON, into one and the same scene.
//!
//! Serde reads what may be a million receptors without a tree in between (JSON) and says the way to what is wrong;
//! its messages are put into our words here. What is within a type but out of range is not refused here but by
//! the scene's own check, which serves built scenes too.
//!
//! Invariant: no key is ignored but `spikes_s` and `promised_spikes`, with which reference scenes tell their answers.

use super::error::{Fault, Problem, figure};
use super::{MOTOR_RANGE, NO_GAINS, Scene};
use crate::pattern::Drive;
use crate::quote::{nearest, one_line, quote};
use crate::skin::{self, Position, RaModel, Rectify};
use firmware_protocol::stroke::MOTORS;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, IgnoredAny, MapAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer};
use serde_path_to_error::{Path, Segment};
use std::fmt;
use std::marker::PhantomData;
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
    let Keyed(raw) = if json { from_json(text) } else { from_toml(text) }?;
    raw.scene()
}

fn from_json(text: &str) -> Result<Keyed<RawScene>, Fault> {
    let mut source = serde_json::Deserializer::from_str(text);
    let scene = serde_path_to_error::deserialize(&mut source).map_err(|error| {
        let (path, error) = (error.path().clone(), error.into_inner());
        let out_of_range = error.to_string().starts_with("number out of range");
        if error.is_data() || out_of_range {
            data(&path, Some(error.line()), without_place(&error).as_str())
        } else {
            json_syntax(&error)
        }
    })?;
    source.end().map_err(|error| json_syntax(&error))?;
    Ok(scene)
}

fn json_syntax(error: &serde_json::Error) -> Fault {
    let message = format!("{} (column {})", one_line(&without_place(error)), error.column());
    Fault::whole(Some(error.line()), Problem::Syntax { language: "JSON", message })
}

/// What is wrong; the line is told elsewhere.
fn without_place(error: &serde_json::Error) -> String {
    let mut message = error.to_string();
    let place = format!(" at line {} column {}", error.line(), error.column());
    message.truncate(message.strip_suffix(&place).map_or(message.len(), str::len));
    message
}

fn from_toml(text: &str) -> Result<Keyed<RawScene>, Fault> {
    let line = |error: &toml::de::Error| {
        let start = error.span()?.start;
        Some(1 + text.bytes().take(start).filter(|&byte| byte == b'\n').count())
    };
    let source = toml::Deserializer::parse(text).map_err(|error| {
        let message = one_line(error.message());
        Fault::whole(line(&error), Problem::Syntax { language: "TOML", message })
    })?;
    serde_path_to_error::deserialize(source)
        .map_err(|error| data(error.path(), line(error.inner()), error.inner().message()))
}

/// Serde's message in our words.
fn data(path: &Path, line: Option<usize>, message: &str) -> Fault {
    let mut keys: Vec<String> = path
        .iter()
        .map(|segment| match segment {
            Segment::Seq { index } => format!("[{index}]"),
            Segment::Map { key } => format!(".{key}"),
            Segment::Enum { .. } | Segment::Unknown => String::new(),
        })
        .collect();
    // Of a key that is itself what is wrong, the path may have it or not.
    let mut named = |key: &str, stays: bool| {
        keys.pop_if(|last| last.strip_prefix('.') == Some(key));
        if stays {
            keys.push(format!(".{key}"));
        }
    };
    let field = |kind: &str| message.strip_prefix(kind)?.strip_suffix('`');
    let problem = if let Some((key, known)) =
        message.strip_prefix("unknown field `").and_then(|rest| rest.rsplit_once("`, expected "))
    {
        named(key, false);
        let known: Vec<&str> = known.split('`').skip(1).step_by(2).collect();
        Problem::UnknownKey { key: quote(key), nearest: nearest(&known, key).to_owned() }
    } else if let Some(key) = field("missing field `") {
        named(key, true);
        Problem::Missing { wanted: wanted(key) }
    } else if let Some(key) = field("duplicate field `") {
        named(key, true);
        Problem::Twice
    } else {
        Problem::Value { message: in_words(message) }
    };
    let path = one_line(keys.concat().trim_start_matches('.'));
    Fault { line: line.filter(|&line| line > 0), path, problem }
}

fn in_words(message: &str) -> String {
    let mistyped = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    let Some((found, wanted)) = mistyped.and_then(|rest| rest.rsplit_once(", expected ")) else {
        return one_line(message);
    };
    let wanted = match wanted {
        "f64" => "a number",
        "u64" => "a whole number, 0 or more",
        "a sequence" => "a list",
        other => other,
    };
    format!("is {}: must be {wanted}", one_line(found))
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

/// A struct that is written with its keys. What serde derives would also take a list of its values.
struct Keyed<T>(T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Keyed<T> {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        struct Keys<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Keys<T> {
            type Value = Keyed<T>;
            fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
                text.write_str("a table of keys and values")
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Keyed<T>, A::Error> {
                T::deserialize(MapAccessDeserializer::new(map)).map(Keyed)
            }
        }
        source.deserialize_map(Keys(PhantomData))
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

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawReceptor {
    #[serde(default, deserialize_with = "rectify")]
    rectify: Rectify,
    alpha_per_um: Option<f64>,
    tau_s: Option<f64>,
    refractory_s: Option<f64>,
    hyperexcitability_s: Option<f64>,
    hyperexcitability_depth: Option<f64>,
    sigma_mm: Option<f64>,
    noise_sd: Option<f64>,
}

impl RawScene {
    fn scene(self) -> Result<Scene, Fault> {
        let (receptors, noise_sd) = match (self.receptors, self.population) {
            // In place: a million of them are held once.
            (Some(receptors), None) => (receptors.into_iter().map(|Keyed(at)| at).collect(), 0.0),
            (None, Some(Keyed(of))) => (skin::population(of.seed), skin::POPULATION_NOISE_SD),
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

impl RawReceptor {
    fn model(self, noise_sd: f64) -> RaModel {
        let usual = RaModel::default_for(self.rectify, noise_sd);
        RaModel {
            rectify: self.rectify,
            alpha_per_um: self.alpha_per_um.unwrap_or(usual.alpha_per_um),
            tau_s: self.tau_s.unwrap_or(usual.tau_s),
            refractory_s: self.refractory_s.unwrap_or(usual.refractory_s),
            hyperexcitability_s: self.hyperexcitability_s.unwrap_or(usual.hyperexcitability_s),
            hyperexcitability_depth: self.hyperexcitability_depth.unwrap_or(usual.hyperexcitability_depth),
            sigma_mm: self.sigma_mm.unwrap_or(usual.sigma_mm),
            noise_sd: self.noise_sd.unwrap_or(noise_sd),
        }
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

fn rectify<'de, D: Deserializer<'de>>(source: D) -> Result<Rectify, D::Error> {
    struct Word;
    impl Visitor<'_> for Word {
        type Value = Rectify;
        fn expecting(&self, text: &mut fmt::Formatter<'_>) -> fmt::Result {
            text.write_str("\"half\", \"full\" or \"signed\"")
        }
        fn visit_str<E: Error>(self, found: &str) -> Result<Rectify, E> {
            match found {
                "half" => Ok(Rectify::Half),
                "full" => Ok(Rectify::Full),
                "signed" => Ok(Rectify::Signed),
                _ => Err(E::custom(format_args!("is {}: must be half, full or signed", quote(found)))),
            }
        }
    }
    source.deserialize_str(Word)
}
