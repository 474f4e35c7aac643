//! The skin model: where the afferents of a fingertip lie, and which spikes they send when pins move.
//!
//! An afferent is a nerve fibre with its receptors; its spikes are what the model computes. The data path:
//!
//! 1. [`membrane`]: the parameters of an afferent, its receptive field, and a population on the fingertip.
//! 2. `scene`: a [`Scene`] holds the drives of the motors, and the afferents with their places and parameters.
//! 3. `breakpoints`: a motor's strokes become the breakpoints of its velocity. Between two breakpoints the velocity
//!    is a straight line. `track` keeps what one motor does, `blocks` merges the motors in order of time, `sampler`
//!    puts the velocity on a grid of steps.
//! 4. `membrane::equation`: the leaky membrane in closed form, and the threshold. `membrane::silence` proves which
//!    afferents cannot reach it.
//! 5. From there two methods lead to spikes. `exact` goes from breakpoint to breakpoint, eight afferents at a time;
//!    where a threshold may be reached, `membrane::neuron` solves for the crossing. It has no time step. `stepped` takes a
//!    fixed step, with forward Euler as in the paper or with the exact propagator of the leak.
//! 6. `engine` shares the afferents out over groups and threads. [`simulate`] gives the [`Answer`].
//!
//! On top of that, an [`Evaluator`] simulates a scene again when some of its motors change, and [`simulate_ramps`] takes measured
//! bursts of motors ([`Ramps`]) instead of drives.
//!
//! The above is the model `membrane`. [`afferents`] is a second model with modules of its own: skin mechanics, and SA1, RA and PC afferents. An [`AnyScene`] is a
//! scene of either model, and reads the files. A [`Finger`] of the second model responds to ramps.
//! [`validate`] compares both models with published figures.
//!
//! Both methods use the same noise, so they can be compared spike by spike. Work is skipped only if the answer is known without it
//! ([`Skipped`]): motors at rest, afferents out of reach or provably silent.
//!
//! Invariant: the answer for an afferent depends on its scene, the method, and its number, which keys its noise. It does not depend
//! on threads, the width of vectors, the other afferents, or skipped work.
//!
//! The crate opens no file and reads no clock.
//!
//! # What the first model leaves out
//!
//! - There is no low-pass filter before the membrane. Above about 50 Hz the model is more sensitive than recorded
//!   afferents are (Freeman & Johnson 1982).
//! - The skin has no mechanics: a receptive field is a sum of Gaussians.
//! - There are no SA1 and no PC afferents, as in the paper.
//! - Rectification, depth of hyperexcitability and reset are our reading of the literature.
//!
//! # Example
//!
//! ```
//! use meissner_skin::{Method, Options, Scene, simulate};
//!
//! let scene = "
//!     duration_s = 0.5
//!     drives = [{ motor = 9, frequency_hz = 60.0, amplitude_um = 80.0 }]
//!     afferents = [{ x_mm = -1.45, y_mm = 1.45 }, { x_mm = 9.0, y_mm = -9.0 }]
//! ";
//! let scene = Scene::read(scene, "scene.toml")?;
//! let answer = simulate(&scene, &Options::rates(Method::Exact), &|_| ())?;
//! let rates_hz = answer.rates_hz(&scene);
//! assert!(rates_hz[0] > 200.0, "the afferent under pin 9");
//! assert_eq!(rates_hz[1], 0.0, "no pin reaches the other");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Sources
//!
//! A constant is marked with its source: (P) the paper, (L) other literature, (C) our own choice.
//!
//! - The paper (P): K. Gwak, J.-C. Park and D.-S. Kim, "A Novel Stimulation Method Based on a Neuromorphic
//!   Mechanoreceptor Model for Haptic Illusion", Korea Advanced Institute of Science and Technology. Its afferent
//!   model is that of S. Bensmaia, "A transduction model of the Meissner corpuscle", *Mathematical Biosciences* 176,
//!   203-217, 2002.
//! - Freeman & Johnson 1982: A. W. Freeman and K. O. Johnson, "A model accounting for effects of vibratory amplitude
//!   on responses of cutaneous mechanoreceptors in macaque monkey", *Journal of Physiology* 323, 43-64, 1982.
//! - Vega-Bermudez & Johnson 1999: F. Vega-Bermudez and K. O. Johnson, "SA1 and RA receptive fields, response
//!   variability, and population responses mapped with a probe array", *Journal of Neurophysiology* 81, 2701-2710, 1999.

pub mod afferents;
pub mod membrane;
pub mod validate;

mod any_scene;
mod blocks;
mod breakpoints;
mod engine;
mod evaluator;
mod exact;
mod finger;
mod member;
mod method;
mod ramps;
mod sampler;
mod scene;
mod simd;
mod simulation;
mod stepped;
#[cfg(test)]
mod tests;
mod time;
mod track;

pub use any_scene::{AnyScene, MAX_JSON_BYTES, MAX_TOML_BYTES};
pub use engine::Skipped;
pub use evaluator::{Candidate, Evaluator};
pub use finger::{Finger, FingerError};
pub use meissner_input::document::{CommonProblem, Place};
pub use method::{
    Integrator, Keep, MAX_SPIKES, Method, MethodError, Options, SEARCH_MIN_WEIGHT, STEP_US, Stepping,
};
pub use ramps::{MAX_RAMPS, Ramps, RampsError, simulate_ramps};
pub use scene::check_model;
pub use scene::{MAX_ALPHA_PER_UM, ModelName, Problem};
pub use scene::{RawAfferent, Scene, SceneError};
pub use simulation::{Answer, simulate};
