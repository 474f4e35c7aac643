//! The second model, `afferents`: skin mechanics under flat pins, and SA1, RA and PC afferents fitted to recordings.
//!
//! The finger lies on the pins, pressed in by 0.5 mm. All pins press on the skin, the moving ones with a changing force. The data
//! path:
//!
//! 1. `scene` and `file`: a [`Scene`] says how the pins move, and lists the afferents with their places. [`population`] places the
//!    afferents of a fingertip.
//! 2. `motion`: the indentation of every pin, 5 000 samples a second.
//! 3. `contact`: indentations become the pins' loads. A pin that would pull the skin has lost contact. A [`Punch`] (`punch`) says what
//!    one load does to the skin.
//! 4. `stimulus`: loads and their rates become the static and the dynamic stimulus of each afferent.
//! 5. `neuron`: stimuli are filtered, become a current, and the current makes spikes. `noise` adds to the current,
//!    `rows` holds the parameters of recorded afferents.
//! 6. `simulation`: [`simulate`] goes through a scene block by block; groups of eight afferents share the threads.
//!
//! [`respond`] gives the spikes for stimuli that the caller computes, as for an object on the finger in place of pins.
//!
//! The step of 0.2 ms is part of the model: its noise and its differences are per sample. So there is no exact method, and
//! a finer step would be another model.
//!
//! Invariant: an afferent's spikes depend on the scene and the afferent's number alone, bit for bit, not on threads, the width of
//! vectors, or the other afferents.
//!
//! # Sources
//!
//! - Saal et al. 2017: H. P. Saal, B. P. Delhaye, B. C. Rayhaun and S. J. Bensmaia, "Simulating tactile signals from the
//!   whole hand with millisecond precision", *PNAS* 114, E5693-E5702, 2017: mechanics, stimuli, parameters.
//! - Dong et al. 2013: Y. Dong, S. Mihalas, S. S. Kim, T. Yoshioka, S. Bensmaia and E. Niebur, "A simple model of
//!   mechanotransduction in primate glabrous skin", *Journal of Neurophysiology* 109, 1350-1359, 2013: the neuron.
//! - Sneddon 1946: I. N. Sneddon, "Boussinesq's problem for a flat-ended cylinder", *Mathematical Proceedings of the
//!   Cambridge Philosophical Society* 42, 29-39, 1946: displacement and pressure under a flat punch.

mod afferent;
mod contact;
mod file;
mod filter;
mod motion;
mod neuron;
mod noise;
mod pin_shapes;
mod population;
mod punch;
mod respond;
mod rows;
mod scene;
mod simulation;
mod stimulus;
#[cfg(test)]
mod tests;

pub use afferent::{Afferent, Class};
pub use pin_shapes::pin_shapes;
pub use population::{LOWER_PER_CM2, UPPER_PER_CM2, population};
pub use punch::Punch;
pub use respond::{Stimuli, respond};
pub use scene::{MAX_PINS, PREINDENT_MM, Scene, SinePin};
pub use simulation::{Answer, simulate};

pub(crate) use file::read;

/// The step, µs.
pub const SAMPLE_US: u32 = 200;
/// Samples per second.
pub const SAMPLES_PER_S: f64 = 5000.0;
/// Young's modulus of the skin, N/mm² (Saal et al. 2017).
pub const ELASTICITY: f64 = 0.05;
/// Poisson's ratio of the skin (Saal et al. 2017).
pub const POISSON: f64 = 0.4;
