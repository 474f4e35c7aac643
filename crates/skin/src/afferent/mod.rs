//! RA afferents: their parameters, their receptive fields, and where they lie in the fingertip.
//!
//! [`AfferentModel`] holds the parameters of an afferent. Its receptive field ([`weight`]) is a Gaussian of the distance
//! between the afferent and a pin. [`population`] places the afferents of a fingertip.
//!
//! Constants are marked with their source: (P) the paper, (L) other literature, (C) our own choice. The crate's front
//! page has the sources in full.
//!
//! Invariant: a position's weights depend only on the position and the width of the field.

mod model;
mod population;

pub use model::{
    AfferentModel, HYPEREXCITABILITY_DEPTH, HYPEREXCITABILITY_S, MIN_THRESHOLD, MIN_WEIGHT, NOISE_LIMIT_SD,
    POPULATION_NOISE_SD, Position, REFRACTORY_S, Rectify, SIGMA_MM, TAU_S, weight,
};
pub(crate) use population::scattered;
pub use population::{LOWER_PER_CM2, PAD_LENGTH_MM, PAD_WIDTH_MM, UPPER_PER_CM2, population};
