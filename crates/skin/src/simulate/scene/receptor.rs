//! What receptors are made of, as a file says it: the keys of `[receptor]`, for scenes and targets alike.
//!
//! Invariant: a model that [`check_model`] passes overflows nowhere in the simulator.

use crate::afferent::{RaModel, Rectify};
use meissner_input::document::{Fault, in_range};
use meissner_input::message::quote;
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// The keys of `[receptor]`.
#[derive(Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RawReceptor {
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

impl RawReceptor {
    /// The model; what is left out has its default, as the noise given.
    pub fn model(self, noise_sd: f64) -> RaModel {
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

/// Every key is there.
impl From<RaModel> for RawReceptor {
    fn from(model: RaModel) -> Self {
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

/// Times of a scene reach to 30 years: `f64` seconds still tell ticks apart.
pub(super) fn seconds<P>(key: &str, found: f64) -> Result<(), Fault<P>> {
    in_range(key, found, (0.0..=1e9).contains(&found), "0 to 1000000000 s")
}

/// The largest α, per µm.
pub const MOST_ALPHA_PER_UM: f64 = 1e15;

/// The ranges leave room for experiments; within them no step of the model overflows.
pub fn check_model<P>(model: &RaModel) -> Result<(), Fault<P>> {
    let RaModel { alpha_per_um, tau_s, refractory_s, noise_sd, sigma_mm, .. } = *model;
    let (lasting_s, depth) = (model.hyperexcitability_s, model.hyperexcitability_depth);
    in_range(
        "alpha_per_um",
        alpha_per_um,
        (0.0..=MOST_ALPHA_PER_UM).contains(&alpha_per_um),
        "0 to 1e15 per um",
    )?;
    in_range("tau_s", tau_s, (1e-9..=1e9).contains(&tau_s), "1e-9 to 1e9 s")?;
    // One spike per refractory period at the most: its least bounds the spikes of a scene.
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
