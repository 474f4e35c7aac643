//! The fingertip: where its RA receptors lie, what they feel of each pin, and what they are made of.
//!
//! An afferent's receptive field is a Gaussian of the distance between receptor and pin. The pad is an ellipse
//! on the middle of the array, denser in receptors towards the fingertip. There are no skin mechanics here and
//! no SA or PC afferents; both are known to be missing.
//!
//! Invariant: a position's weights depend on nothing but the position and the field's width.

use serde::{Deserialize, Serialize};

/// A weight below this counts as 0: beyond 7.46 mm at the default width a pin is not felt.
pub const LEAST_WEIGHT: f64 = 1e-10;

/// A place on the skin; the array's axes: x across the finger, y towards the fingertip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Position {
    /// From the array's middle.
    pub x_mm: f64,
    /// From the array's middle.
    pub y_mm: f64,
}

/// Which part of the skin's velocity depolarises a receptor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rectify {
    /// Indentation only, `max(u, 0)`.
    #[default]
    Half,
    /// Both ways, `|u|`.
    Full,
    /// The paper's equation read literally, `u`.
    Signed,
}

/// The RA mechanoreceptor's parameters: an integrate-and-fire membrane whose resting threshold is 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaModel {
    /// What the input is rectified to.
    pub rectify: Rectify,
    /// Depolarisation per µm of skin displacement.
    pub alpha_per_um: f64,
    /// Time constant of the membrane.
    pub tau_s: f64,
    /// No spike earlier than this after a spike.
    pub refractory_s: f64,
    /// For how long after a spike the threshold is lowered.
    pub hyperexcitability_s: f64,
    /// By how much, right after the spike.
    pub hyperexcitability_depth: f64,
    /// Width of the receptive field.
    pub sigma_mm: f64,
    /// SD of the threshold, drawn once per inter-spike interval.
    pub noise_sd: f64,
}
