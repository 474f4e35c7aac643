//! Scenes: what vibrates, for how long, and which receptors are watched.

use crate::pattern::Drive;
use crate::skin::{Position, RaModel};

/// A checked scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// How long is watched. It only ends the observation: every burst that starts before it exists.
    pub duration_s: f64,
    /// Of the threshold noise.
    pub seed: u64,
    /// What the motors do.
    pub drives: Vec<Drive>,
    /// Where the receptors lie.
    pub receptors: Vec<Position>,
    /// What they are made of.
    pub model: RaModel,
}
