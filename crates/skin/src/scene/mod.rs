//! Scenes: which motors vibrate, for how long, and which afferents are simulated.
//!
//! `file` has the keys of a file, which [`Scene::read`] reads; [`Scene::new`] builds a scene (`checked`). Its drives may be faster and
//! larger than a pattern's: a model has no current limit. A scene belongs to an array; a file that names none is for the paper's.
//! All afferents of a scene have the same parameters. A gain may scale a motor's travel; files have no key for it. Scenes that are
//! made from one another share their afferents, because an optimiser makes thousands of scenes.
//!
//! Invariant: every [`Scene`] has been checked: each number is finite and within its range, and no two drives of a motor
//! overlap.

mod afferent;
mod checked;
mod error;
mod file;
mod names;

pub use afferent::{MAX_ALPHA_PER_UM, RawAfferent, check_model};
pub use checked::Scene;
pub(crate) use checked::{MAX_GAIN, check_drives};
pub(crate) use error::KeyError;
pub use error::{Problem, SceneError};
pub(crate) use file::{RawPopulation, RawScene, array};
pub use names::ModelName;
