//! From drives and receptors to spikes.

mod scene;

pub use scene::Scene;
