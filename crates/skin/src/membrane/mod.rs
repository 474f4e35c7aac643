//! The first model, `membrane`: RA afferents, their parameters and receptive fields, where they lie in the fingertip, and
//! the equation of their membrane.
//!
//! `model` has the parameters of an afferent ([`AfferentModel`]) and its receptive field ([`weight`]), a Gaussian of the distance
//! between the afferent and a pin. [`population`] places the afferents of a fingertip.
//!
//! `equation` is the membrane in closed form. `neuron` finds the instant at which it reaches the threshold, and `silence` proves
//! that it cannot. Methods and threads are the crate's.
//!
//! Constants are marked with their source: (P) the paper, (L) other literature, (C) our own choice. The crate's front
//! page has the sources in full.
//!
//! Invariant: a position's weights depend only on the position and the width of the field.

pub(crate) mod equation;
mod model;
pub(crate) mod neuron;
mod population;
pub(crate) mod silence;

pub use model::{
    AfferentModel, HYPEREXCITABILITY_DEPTH, HYPEREXCITABILITY_S, MIN_THRESHOLD, MIN_WEIGHT, NOISE_LIMIT_SD,
    POPULATION_NOISE_SD, Position, REFRACTORY_S, Rectify, SIGMA_MM, TAU_S, weight,
};
pub(crate) use population::scattered;
pub use population::{LOWER_PER_CM2, PAD_LENGTH_MM, PAD_WIDTH_MM, UPPER_PER_CM2, population};
