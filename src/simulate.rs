//! From drives and receptors to spikes.

mod scene;

pub use scene::{MAX_JSON_BYTES, MAX_TOML_BYTES, Place, Problem, Scene, SceneError};
