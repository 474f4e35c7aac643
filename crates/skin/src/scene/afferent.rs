//! The parameters of afferents in a file: the keys of `[afferent]`, for scenes and targets alike.
//!
//! Invariant: a model that [`check_model`] accepts causes no overflow in the simulator.

use crate::membrane::{AfferentModel, Rectify};
use meissner_input::document::{KeyError, in_range};
use meissner_input::message::quote;
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// The keys of `[afferent]`.
#[derive(Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RawAfferent {
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

impl RawAfferent {
    /// The model. A missing parameter has its default; `noise_sd` is the default of the noise.
    pub fn model(self, noise_sd: f64) -> AfferentModel {
        let usual = AfferentModel::default_for(self.rectify, noise_sd);
        AfferentModel {
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

/// With every key.
impl From<AfferentModel> for RawAfferent {
    fn from(model: AfferentModel) -> Self {
        Self {
            rectify: model.rectify,
            alpha_per_um: Some(model.alpha_per_um),
            tau_s: Some(model.tau_s),
            refractory_s: Some(model.refractory_s),
            hyperexcitability_s: Some(model.hyperexcitability_s),
            hyperexcitability_depth: Some(model.hyperexcitability_depth),
            sigma_mm: Some(model.sigma_mm),
            noise_sd: Some(model.noise_sd),
        }
    }
}

/// Checks a time of a scene. Up to 30 years, seconds in `f64` resolve ticks.
pub(super) fn seconds<P>(key: &str, found: f64) -> Result<(), KeyError<P>> {
    in_range(key, found, (0.0..=1e9).contains(&found), "0 to 1000000000 s")
}

/// The largest α, per µm.
pub const MAX_ALPHA_PER_UM: f64 = 1e15;

/// Checks the parameters of afferents. The ranges leave room for experiments; within them no step of the model overflows.
///
/// # Errors
/// The first parameter that is out of range, by its key.
pub fn check_model<P>(model: &AfferentModel) -> Result<(), KeyError<P>> {
    let AfferentModel { alpha_per_um, tau_s, refractory_s, noise_sd, sigma_mm, .. } = *model;
    let (lasting_s, depth) = (model.hyperexcitability_s, model.hyperexcitability_depth);
    in_range(
        "alpha_per_um",
        alpha_per_um,
        (0.0..=MAX_ALPHA_PER_UM).contains(&alpha_per_um),
        "0 to 1e15 per um",
    )?;
    in_range("tau_s", tau_s, (1e-9..=1e9).contains(&tau_s), "1e-9 to 1e9 s")?;
    // There is at most one spike per refractory period, so the shortest period bounds the spikes of a scene.
    in_range("refractory_s", refractory_s, (1e-5..=1e9).contains(&refractory_s), "1e-5 to 1e9 s")?;
    seconds("hyperexcitability_s", lasting_s)?;
    in_range("hyperexcitability_depth", depth, (0.0..=1.0).contains(&depth), "0 to 1")?;
    in_range("sigma_mm", sigma_mm, (1e-3..=1e6).contains(&sigma_mm), "0.001 to 1000000 mm")?;
    in_range("noise_sd", noise_sd, (0.0..=1e6).contains(&noise_sd), "0 to 1000000")
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
